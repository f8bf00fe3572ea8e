//! Opening a data folder: the database of an earlier release, file modes, the size of the database.

use super::database::Store;
use super::error::StoreError;
use super::folders::PAGES;
use super::migrations::SQLITE;
use sqlx::migrate::Migrator;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::borrow::Cow;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

/// Last migration before the column `crashes`.
const BEFORE_CRASHES: i64 = 4;

/// Last migration before the counters of the table `tenants`.
const BEFORE_TENANT_COUNTERS: i64 = 10;

/// Creates the database of an earlier release, whose last migration was `last`.
async fn database_of(folder: &Path, last: i64) -> SqliteConnection {
    let options = SqliteConnectOptions::new().filename(folder.join("wandless.db")).create_if_missing(true);
    let mut database = options.connect().await.unwrap();
    let old: Vec<_> = SQLITE.iter().filter(|migration| migration.version <= last).cloned().collect();
    let migrator = Migrator { migrations: Cow::Owned(old), ..Migrator::DEFAULT };
    migrator.run(&mut database).await.unwrap();
    database
}

#[tokio::test]
async fn counters_of_an_earlier_release_are_taken_over() {
    let folder = tempfile::tempdir().unwrap();
    let mut database = database_of(folder.path(), BEFORE_TENANT_COUNTERS).await;
    for (id, tenant, state) in [("a", "x", "queued"), ("b", "x", "queued"), ("c", "y", "canceled")] {
        sqlx::query(
            "INSERT INTO jobs (id, tenant, session_id, options, labels, priority, state, created_at, finished_at)
             VALUES ($1, $2, 's', '{}', '{}', 0, $3, '2026-01-01T00:00:00.000Z',
                     CASE $3 WHEN 'queued' THEN NULL ELSE '2026-01-01T00:00:00.000Z' END)",
        )
        .bind(id)
        .bind(tenant)
        .bind(state)
        .execute(&mut database)
        .await
        .unwrap();
    }
    database.close().await.unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    let counters =
        sqlx::query_as("SELECT name, n_queued, n_canceled FROM tenants WHERE name <> 'default' ORDER BY name");
    let counters: Vec<(String, i64, i64)> = counters.fetch_all(store.read()).await.unwrap();
    assert_eq!(counters, [("x".to_owned(), 2, 0), ("y".to_owned(), 0, 1)]);
    store.close().await;
}

#[tokio::test]
async fn garbage_in_place_of_the_database_is_named_at_once() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("wandless.db"), "no database ".repeat(1000)).unwrap();
    let opened = tokio::time::timeout(Duration::from_secs(10), Store::open(folder.path())).await;
    let error = opened.expect("a pool waited for a connection").unwrap_err();
    assert!(matches!(error, StoreError::DatabaseDamaged { .. }), "{error}");
}

#[tokio::test]
async fn keeps_the_crash_count_of_an_earlier_release() {
    let folder = tempfile::tempdir().unwrap();
    let mut database = database_of(folder.path(), BEFORE_CRASHES).await;
    let job = "INSERT INTO jobs (id, session_id, options, labels, priority, state, deaths, created_at)
         VALUES ('j', 's', '{}', '{}', 0, 'queued', 2, '2026-01-01T00:00:00.000Z')";
    sqlx::query(job).execute(&mut database).await.unwrap();
    database.close().await.unwrap();

    let store = Store::open(folder.path()).await.unwrap();
    let crashes: i64 = sqlx::query_scalar("SELECT crashes FROM jobs").fetch_one(store.read()).await.unwrap();
    assert_eq!(crashes, 2);
    store.close().await;
}

fn mode(path: &Path) -> u32 {
    std::fs::metadata(path).unwrap().permissions().mode() & 0o777
}

#[tokio::test(flavor = "multi_thread")]
async fn data_is_readable_by_its_owner_alone() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    Store::open(&data).await.unwrap().close().await;
    let loosen = |name: &str, mode: u32| {
        std::fs::set_permissions(data.join(name), std::fs::Permissions::from_mode(mode)).unwrap();
    };
    loosen("", 0o755);
    loosen("wandless.db", 0o644);
    let store = Store::open(&data).await.unwrap(); // the folder of an earlier release
    store.checkpoint().await.unwrap();
    assert_eq!(mode(&data), 0o700);
    for name in ["wandless.db", "wandless.db-wal", "wandless.db-shm", PAGES, "lock", "reserve"] {
        assert_eq!(mode(&data.join(name)), 0o600, "{name}");
    }
    store.close().await;
}

/// Fills a table of its own with `pages` pages, and empties it.
async fn fill_and_empty(store: &Store, pages: i64) -> Result<(), StoreError> {
    let mut transaction = store.write().await?;
    sqlx::query("CREATE TABLE IF NOT EXISTS filler (bytes BLOB)").execute(&mut *transaction).await?;
    sqlx::query(
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < $1)
         INSERT INTO filler SELECT randomblob(4000) FROM n",
    )
    .bind(pages)
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await?;
    store.checkpoint().await?;
    let mut transaction = store.write().await?;
    sqlx::query("DELETE FROM filler").execute(&mut *transaction).await?;
    Ok(transaction.commit().await?)
}

#[tokio::test(flavor = "multi_thread")]
async fn database_shrinks_after_deletions() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    fill_and_empty(&store, 5000).await.unwrap();
    let full = store.disk_usage().database_bytes;
    for _ in 0..4 {
        store.shrink().await.unwrap();
        store.checkpoint().await.unwrap();
    }
    let empty = store.disk_usage().database_bytes;
    assert!(full > 20_000_000 && empty < 8_000_000, "{full} {empty}");
    store.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn loose_database_of_an_earlier_release_is_rewritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wandless.db");
    let plain = SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let mut database = plain.connect().await.unwrap();
    SQLITE.run(&mut database).await.unwrap(); // without the setting that lets the file shrink step by step
    database.close().await.unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    fill_and_empty(&store, 3000).await.unwrap();
    store.close().await;
    drop(store); // and the lock of the folder with it
    let loose = std::fs::metadata(&path).unwrap().len();
    let store = Store::open(folder.path()).await.unwrap();
    let mode: i64 = sqlx::query_scalar("PRAGMA auto_vacuum").fetch_one(store.read()).await.unwrap();
    store.close().await;
    let tight = std::fs::metadata(&path).unwrap().len();
    assert!(mode == 2 && loose > 12_000_000 && tight < 2_000_000, "{mode} {loose} {tight}");
}

#[tokio::test(flavor = "multi_thread")]
async fn interrupted_creation_is_repeated_by_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    // What a kill can leave: parts of the new file and of its log, no database; beside it the log of a removed database.
    for name in ["wandless.db.new", "wandless.db.new-wal", "wandless.db.new-journal", "wandless.db-wal"] {
        std::fs::write(folder.path().join(name), [7; 5000]).unwrap();
    }
    let store = Store::open(folder.path()).await.unwrap();
    let found: String = sqlx::query_scalar("PRAGMA integrity_check").fetch_one(store.read()).await.unwrap();
    assert_eq!(found, "ok");
    let applied = sqlx::query_scalar::<_, i64>("SELECT count(*) FROM _sqlx_migrations WHERE success");
    assert_eq!(applied.fetch_one(store.read()).await.unwrap(), SQLITE.iter().count() as i64);
    store.close().await;
    let names =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let beside: Vec<String> = names.filter(|name| name.contains(".new")).collect();
    assert!(beside.is_empty(), "{beside:?}");
}
