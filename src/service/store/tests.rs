//! Opening the database of an earlier release.

use super::database::{MIGRATIONS, Store};
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use std::borrow::Cow;

/// Last migration of the release before the column `crashes`.
const OLD_RELEASE: i64 = 4;

#[tokio::test]
async fn keeps_the_crash_count_of_an_earlier_release() {
    let folder = tempfile::tempdir().unwrap();
    let options = SqliteConnectOptions::new().filename(folder.path().join("wandless.db")).create_if_missing(true);
    let mut database = options.connect().await.unwrap();
    let all = MIGRATIONS.iter().cloned();
    let old: Vec<_> = all.filter(|migration| migration.version <= OLD_RELEASE).collect();
    let migrator = Migrator { migrations: Cow::Owned(old), ..Migrator::DEFAULT };
    migrator.run(&mut database).await.unwrap();
    let job = "INSERT INTO jobs (id, session_id, options, labels, priority, state, deaths, created_at)
         VALUES ('j', 's', '{}', '{}', 0, 'queued', 2, '2026-01-01T00:00:00.000Z')";
    sqlx::query(job).execute(&mut database).await.unwrap();
    database.close().await.unwrap();

    let store = Store::open(folder.path()).await.unwrap();
    let crashes: i64 = sqlx::query_scalar("SELECT crashes FROM jobs").fetch_one(store.read()).await.unwrap();
    assert_eq!(crashes, 2);
    store.close().await;
}
