//! Every changed byte is detected.

use super::*;
use crate::service::store::tenants::{self, Tenant};

async fn written(folder: &Path) -> Store {
    let store = Store::open(folder).await.unwrap();
    for tenant in ["first", "second"] {
        let mut transaction = store.write().await.unwrap();
        let tenant = Tenant::parse(tenant).unwrap();
        tenants::insert_if_missing(&mut transaction, &tenant).await.unwrap();
        transaction.commit().await.unwrap();
    }
    store
}

fn flipped(path: &Path, at: usize) -> Vec<u8> {
    let whole = std::fs::read(path).unwrap();
    let mut bytes = whole.clone();
    bytes[at] ^= 1 << (at % 8);
    std::fs::write(path, bytes).unwrap();
    whole
}

#[tokio::test(flavor = "multi_thread")]
async fn detects_any_changed_byte_of_a_stopped_database() {
    let folder = tempfile::tempdir().unwrap();
    written(folder.path()).await.close().await;
    let database = folder.path().join("wandless.db");
    assert!(matches!(compare_once(&database).unwrap(), Compared::Intact(n) if n > 10));
    for path in [&database, &folder.path().join(PAGES)] {
        let length = std::fs::metadata(path).unwrap().len() as usize;
        for at in (0..length).step_by(length / 97) {
            let whole = flipped(path, at);
            assert!(matches!(compare_once(&database), Ok(Compared::Damaged(_)) | Err(_)), "{}: {at}", path.display());
            std::fs::write(path, whole).unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn detects_any_changed_byte_of_a_killed_services_log() {
    let folder = tempfile::tempdir().unwrap();
    let store = written(folder.path()).await; // never closed, as after a kill
    let killed = tempfile::tempdir().unwrap();
    store.checkpoint().await.unwrap();
    let mut transaction = store.write().await.unwrap();
    let late = Tenant::parse("late").unwrap();
    tenants::insert_if_missing(&mut transaction, &late).await.unwrap();
    transaction.commit().await.unwrap();
    for name in ["wandless.db", "wandless.db-wal", PAGES] {
        std::fs::copy(folder.path().join(name), killed.path().join(name)).unwrap();
    }
    let (database, log) = (killed.path().join("wandless.db"), killed.path().join("wandless.db-wal"));
    assert!(matches!(compare_once(&database).unwrap(), Compared::Intact(_)));
    let live = {
        let n_pages = Log::read(&log).unwrap().pages.len();
        assert!((1..10).contains(&n_pages), "the log restarts after the checkpoint: {n_pages}");
        32 + (24 + 4096) * n_pages
    };
    for at in (0..live).step_by(13) {
        let whole = flipped(&log, at);
        assert!(matches!(compare_once(&database), Ok(Compared::Damaged(_)) | Err(_)), "log: {at}");
        std::fs::write(&log, whole).unwrap();
    }
    let length = std::fs::metadata(&database).unwrap().len() as usize;
    let in_log = Log::read(&log).unwrap().pages;
    for at in (0..length).step_by(length / 97).filter(|at| !in_log.contains(&((at / 4096) as u32 + 1))) {
        let whole = flipped(&database, at);
        assert!(matches!(compare_once(&database), Ok(Compared::Damaged(_)) | Err(_)), "database: {at}");
        std::fs::write(&database, whole).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_checkpoint_reads_changed_pages_only() {
    let folder = tempfile::tempdir().unwrap();
    let store = written(folder.path()).await;
    store.checkpoint().await.unwrap();
    let database = folder.path().join("wandless.db");
    let known = PageDigests::read(&folder.path().join(PAGES)).unwrap();
    let length = std::fs::metadata(&database).unwrap().len() as usize;
    let whole = flipped(&database, length - 1); // a page that is read again would have a new digest
    let log = Log { pages: [2].into(), damage: None };
    assert_eq!(PageDigests::of(&database, Some((&known, &log))).unwrap(), known);
    assert_ne!(PageDigests::of(&database, None).unwrap(), known);
    std::fs::write(&database, whole).unwrap();
    store.close().await;
}
