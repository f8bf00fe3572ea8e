//! The store of the services under test: the data folder, or, where `WANDLESS_TEST_POSTGRES` names a server, a database of their own there
//! with the objects in `<data>/objects`, or in the bucket that `WANDLESS_TEST_S3` names.

use std::path::Path;
use std::process::Command;

/// The URL of the PostgreSQL server, whose user may create databases.
fn server() -> Option<String> {
    std::env::var("WANDLESS_TEST_POSTGRES").ok()
}

/// Whether the test checks what only SQLite and the data folder have; says so where it is left out.
pub fn is_of_sqlite_alone(what: &str) -> bool {
    let is_left_out = server().is_some();
    if is_left_out {
        eprintln!("SKIPPED on PostgreSQL: {what}");
    }
    is_left_out
}

/// Folder, below the data folder, of the files that a service has accepted or published.
pub fn folder_of(name: &str) -> String {
    match server() {
        Some(_) if ["sessions", "results", "checkpoints"].contains(&name) => format!("objects/{name}"),
        _ => name.to_owned(),
    }
}

/// The program with the store of this data folder in its environment.
pub fn program(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wandless"));
    if let Some(server) = server() {
        let name = database_of(&server, data);
        let (place, query) = server.split_once('?').unwrap_or((&server, ""));
        let (place, _) = place.rsplit_once('/').unwrap();
        let blobs = match std::env::var("WANDLESS_TEST_S3") {
            Ok(bucket) => format!("{}/{name}", bucket.trim_end_matches('/')),
            Err(_) => format!("file://{}/objects", data.display()),
        };
        command.env("WANDLESS_STORE__URL", format!("{place}/{name}?{query}")).env("WANDLESS_BLOBS__URL", blobs);
        // The jobs of a killed service come back after a lease.
        command.env("WANDLESS_WORKER__BEAT_S", "0.3").env("WANDLESS_WORKER__LEASE_S", "1.5");
    }
    command
}

/// Name of the database of a data folder, which is created at its first use.
#[cfg(feature = "scale")]
fn database_of(server: &str, data: &Path) -> String {
    use sha2::{Digest, Sha256};
    use sqlx::{AssertSqlSafe, ConnectOptions, Connection};
    use std::collections::BTreeSet;
    use std::sync::Mutex;

    static CREATED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let name = format!("service_{}", &hex::encode(Sha256::digest(data.as_os_str().as_encoded_bytes()))[..16]);
    if CREATED.lock().unwrap().insert(name.clone()) {
        let options: sqlx::postgres::PgConnectOptions = server.parse().unwrap();
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(async {
            let mut connection = options.connect().await.unwrap();
            let create = sqlx::query(AssertSqlSafe(format!("CREATE DATABASE {name}")));
            create.execute(&mut connection).await.unwrap();
            connection.close().await.unwrap();
        });
    }
    name
}

#[cfg(not(feature = "scale"))]
fn database_of(server: &str, _: &Path) -> String {
    panic!("WANDLESS_TEST_POSTGRES is {server}, but the tests were built without the feature `scale`");
}
