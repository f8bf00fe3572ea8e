//! The migrations as part of the program. They are listed here in place of `sqlx::migrate!`: the macros of sqlx build both drivers,
//! SQLite and TLS once more for the compiler.

use sqlx::SqlSafeStr;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use std::sync::LazyLock;

/// The files of a folder below `migrations/`: per file its name and its text.
macro_rules! files {
    ($folder:literal: $($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../migrations/", $folder, "/", $name, ".sql")))),*]
    };
}

/// Those of the embedded database.
pub(super) static SQLITE: LazyLock<Migrator> = LazyLock::new(|| {
    migrator(files!("sqlite":
        "0001_sessions_and_jobs",
        "0002_results",
        "0003_tenants",
        "0004_webhooks",
        "0005_crashes",
        "0006_webhook_secret_rotation",
        "0007_lists_and_totals",
        "0008_keys_and_clock",
        "0010_job_submitter",
        "0011_tenant_counters",
        "0012_storage",
        "0013_classes",
        "0014_suspicions",
    ))
});

/// Those of a server.
#[cfg(feature = "scale")]
pub(super) static POSTGRES: LazyLock<Migrator> = LazyLock::new(|| {
    migrator(files!("postgres":
        "0001_tables",
        "0002_classes_losses_and_gate",
        "0003_totals_and_late_counters",
        "0004_suspicions",
    ))
});

/// Migrations by the number that begins their name; the rest of it is the description, with blanks in place of `_`.
fn migrator(files: &[(&'static str, &'static str)]) -> Migrator {
    let migration = |&(name, text): &(&str, &'static str)| {
        let (number, description) = name.split_once('_').unwrap_or((name, ""));
        // A test fails for a name without a number.
        let version = number.parse().unwrap_or(0);
        Migration::new(version, description.replace('_', " ").into(), MigrationType::Simple, text.into_sql_str(), false)
    };
    Migrator::with_migrations(files.iter().map(migration).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_holds_all_of(migrations: &Migrator, folder: &str) {
        let files = std::fs::read_dir(format!("{}/migrations/{folder}", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let mut names: Vec<_> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        let name = |m: &Migration| format!("{:04}_{}.sql", m.version, m.description.replace(' ', "_"));
        assert_eq!(migrations.iter().map(name).collect::<Vec<_>>(), names);
    }

    #[test]
    fn every_file_is_listed() {
        assert_holds_all_of(&SQLITE, "sqlite");
        #[cfg(feature = "scale")]
        assert_holds_all_of(&POSTGRES, "postgres");
    }

    /// A database holds the digests of its migrations, and no release may change them.
    #[test]
    fn digest_is_sha384_of_the_file() {
        let first = SQLITE.iter().next().unwrap();
        let digest = "9ad584169fa9c29de00101477555795d66b994aa437f0496\
                      6a9aae1addde69ba4628dd46cab16a578b16d7797d5cbec7";
        assert_eq!(hex::encode(&*first.checksum), digest);
    }
}
