//! Stores of the tests: in the temporary folder, or, where `WANDLESS_TEST_POSTGRES` names a server, in a database of their own there.

use super::database::Store;
use super::sessions::SessionSummary;
use std::path::Path;

/// Variable with the URL of a PostgreSQL server whose user may create databases.
const VARIABLE: &str = "WANDLESS_TEST_POSTGRES";

/// Opens the store of a test. The same folder is the same database.
pub(crate) async fn open(folder: &Path) -> Store {
    let Ok(server) = std::env::var(VARIABLE) else { return Store::open(folder).await.unwrap() };
    #[cfg(not(feature = "scale"))]
    panic!("{VARIABLE} is {server}, but the tests were built without the feature `scale`");
    #[cfg(feature = "scale")]
    open_postgres(&server, folder).await
}

/// A small session.
pub(crate) fn summary() -> SessionSummary {
    SessionSummary {
        name: "take".to_owned(),
        sha256: "00".to_owned(),
        cameras: 0,
        frames: 3,
        people_max: 1,
        keypoint_convention: "coco17".to_owned(),
        format: "native".to_owned(),
        warnings: Vec::new(),
        bytes: 5,
        camera_facts: Vec::new(),
    }
}

/// Whether the test checks what only SQLite has; says so where it is left out.
pub(crate) fn is_of_sqlite_alone(what: &str) -> bool {
    let is_left_out = std::env::var(VARIABLE).is_ok();
    if is_left_out {
        eprintln!("SKIPPED on PostgreSQL: {what}");
    }
    is_left_out
}

/// Opens the database of a test once more, as another process does; `None` with SQLite.
#[cfg(feature = "scale")]
pub(crate) async fn open_again(folder: &Path) -> Option<Result<Store, super::StoreError>> {
    use super::folders::Folders;
    let server = std::env::var(VARIABLE).ok()?;
    Some(Store::connect(&settings_of(&server, folder), Folders::beside(folder).unwrap()).await)
}

/// The settings of the test's database on a server.
#[cfg(feature = "scale")]
fn settings_of(server: &str, folder: &Path) -> crate::service::Settings {
    let mut settings = crate::service::Settings::default();
    let (place, query) = server.split_once('?').unwrap_or((server, ""));
    let place = place.rsplit_once('/').unwrap().0;
    settings.store.url = format!("{place}/{}?{query}", name_of(folder));
    settings
}

#[cfg(feature = "scale")]
fn name_of(folder: &Path) -> String {
    use sha2::{Digest, Sha256};
    format!("test_{}", &hex::encode(Sha256::digest(folder.as_os_str().as_encoded_bytes()))[..16])
}

#[cfg(feature = "scale")]
async fn open_postgres(server: &str, folder: &Path) -> Store {
    use super::folders::Folders;
    use sqlx::postgres::PgConnectOptions;
    use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

    let name = name_of(folder);
    let options: PgConnectOptions = server.parse().unwrap();
    let mut connection = options.connect().await.unwrap();
    match sqlx::query(AssertSqlSafe(format!("CREATE DATABASE {name}"))).execute(&mut connection).await {
        Err(sqlx::Error::Database(error)) if error.code().as_deref() == Some("42P04") => {} // the test has opened it before
        created => _ = created.unwrap(),
    }
    connection.close().await.unwrap();
    Store::connect(&settings_of(server, folder), Folders::open(folder).unwrap()).await.unwrap()
}
