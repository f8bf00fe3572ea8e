//! Tests of an object store: in memory, or, where `WANDLESS_TEST_S3` has the URL of a bucket, in that (`AWS_*` as for the service).

use super::objects::Objects;
use super::remote::Remote;
use super::strays::sweep_older_than;
use super::*;
use crate::service::store::artifacts::{digest_file, scan};
use crate::service::store::random::new_id;
use crate::service::store::{Store, Tenant, sessions, test_support};
use object_store::memory::InMemory;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"; // FIPS 180-2, appendix B.1

struct Place {
    folder: TempDir,
    folders: Folders,
    objects: Objects,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let folders = Folders::open(folder.path()).unwrap();
        let objects = match std::env::var("WANDLESS_TEST_S3") {
            Ok(url) => Objects::open(&format!("{}/{}", url.trim_end_matches('/'), new_id("test"))).unwrap(),
            Err(_) => Objects::new(Arc::new(InMemory::new())),
        };
        Self { folder, folders, objects }
    }

    /// The object store of a process with an empty cache.
    fn remote(&self, cache_bytes: u64) -> Remote {
        let cache = self.folder.path().join("cache");
        if cache.exists() {
            std::fs::remove_dir_all(cache).unwrap();
        }
        Remote::new(self.objects.clone(), cache_bytes, &self.folders).unwrap()
    }

    async fn upload(&self, remote: &Remote, id: &str, bytes: &[u8]) -> String {
        let file = self.folders.session(id);
        std::fs::write(&file, bytes).unwrap();
        let sha256 = digest_file(&file).unwrap().sha256;
        remote.take_session(id, &sha256).await.unwrap();
        assert!(!file.exists(), "the file was handed over");
        sha256
    }
}

#[tokio::test]
async fn an_upload_comes_back_on_another_machine() {
    let place = Place::new();
    let large: Vec<u8> = (0..20_000_000_u32).map(|n| (n % 251) as u8).collect(); // three parts
    let sha256 = place.upload(&place.remote(1 << 30), "s", &large).await;
    let file = place.remote(1 << 30).session("s", &sha256).await.unwrap();
    assert!(std::fs::read(&file.path).unwrap() == large);
}

#[tokio::test]
async fn other_bytes_than_the_stored_ones_are_never_given() {
    let place = Place::new();
    let remote = place.remote(1 << 20);
    place.upload(&remote, "s", b"abc").await;
    let copy = remote.session("s", ABC).await.unwrap().path;
    std::fs::write(&copy, b"xyz").unwrap();
    // The next process does not know the copy: it compares it, and fetches the object again.
    let next = Remote::new(place.objects.clone(), 1 << 20, &place.folders).unwrap();
    assert_eq!(std::fs::read(next.session("s", ABC).await.unwrap().path).unwrap(), b"abc");
    let other = place.folder.path().join("other");
    std::fs::write(&other, b"xyz").unwrap();
    place.objects.put_file("sessions/s", &other).await.unwrap();
    let damaged = place.remote(1 << 20).session("s", ABC).await.unwrap_err();
    assert!(damaged.to_string().starts_with("sessions/s: the digest differs"), "{damaged}");
    let missing = place.remote(1 << 20).session("t", ABC).await.unwrap_err();
    assert!(matches!(missing, StoreError::BlobDamaged { reason: "the object is missing", .. }), "{missing}");
}

#[tokio::test]
async fn the_longest_unused_copies_make_room() {
    let place = Place::new();
    let remote = place.remote(25);
    let mut sha256 = Vec::new();
    for (id, byte) in [("a", 1), ("b", 2), ("c", 3)] {
        sha256.push(place.upload(&remote, id, &[byte; 10]).await);
    }
    let cached = || {
        let names = std::fs::read_dir(place.folder.path().join("cache")).unwrap();
        let names: BTreeSet<String> = names.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        sha256.iter().map(|sha256| names.contains(sha256)).collect::<Vec<_>>()
    };
    assert_eq!(cached(), [false, true, true]);
    let held = remote.session("b", &sha256[1]).await.unwrap();
    drop(remote.session("c", &sha256[2]).await.unwrap());
    drop(remote.session("a", &sha256[0]).await.unwrap());
    assert_eq!(cached(), [true, true, false], "a copy that is read stays");
    assert_eq!(std::fs::read(&held.path).unwrap(), [2; 10]);
}

/// A result folder with two files of the same bytes.
fn write_result(folder: &Path) -> Vec<Artifact> {
    std::fs::create_dir_all(folder.join("smpl")).unwrap();
    for (name, text) in [("report.json", "{}"), ("smpl/0.npz", "abc"), ("smpl/1.npz", "abc")] {
        std::fs::write(folder.join(name), text).unwrap();
    }
    scan(folder).unwrap()
}

#[tokio::test]
async fn a_result_is_whole_on_another_machine() {
    let place = Place::new();
    let remote = place.remote(1 << 20);
    let files = write_result(&place.folders.result("j", 2));
    remote.take_result("j", 2, &files).await.unwrap();
    assert!(!place.folders.job("j").exists());
    let remote = place.remote(1 << 20);
    let report = remote.artifact("j", 2, &files[0]).await.unwrap();
    assert_eq!(std::fs::read(&report.path).unwrap(), b"{}");
    let result = remote.result("j", 2, &files).await.unwrap();
    assert_eq!(scan(&result.path).unwrap(), files);
    let folder = result.path.clone();
    drop(result);
    assert!(!folder.exists());
    remote.remove("results/j").await;
    assert!(place.objects.list("results").await.unwrap().is_empty());
}

#[tokio::test]
async fn checkpoints_follow_their_job() {
    let place = Place::new();
    let remote = place.remote(1 << 20);
    let folder = place.folders.checkpoints("j");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("cameras.ckpt"), "one").unwrap();
    std::fs::write(folder.join("repair.ckpt.tmp"), "half").unwrap();
    let mut kept = BTreeSet::new();
    remote.keep_checkpoints("j", &mut kept).await;
    remote.keep_checkpoints("j", &mut kept).await;
    assert_eq!(kept, BTreeSet::from(["cameras.ckpt".to_owned()]));
    std::fs::remove_dir_all(&folder).unwrap();
    remote.fetch_checkpoints("j").await;
    assert_eq!(std::fs::read(folder.join("cameras.ckpt")).unwrap(), b"one");
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

#[tokio::test]
async fn the_sweep_removes_old_objects_without_a_row_only() {
    let folder = tempfile::tempdir().unwrap();
    let mut store: Store = test_support::open(folder.path()).await;
    let place = Place { folders: store.folders.clone(), ..Place::new() };
    let remote = place.remote(1 << 20);
    for id in ["s", "stray"] {
        place.upload(&remote, id, id.as_bytes()).await;
    }
    let summary = test_support::summary();
    sessions::add(&store, &Tenant::default_tenant(), "s", &summary, i64::MAX).await.unwrap();
    let files = write_result(&store.folders.result("j", 1));
    remote.take_result("j", 1, &files).await.unwrap();
    store.blobs = Blobs::Remote(remote);
    assert_eq!(sweep_older_than(&store, 3600).await.unwrap(), 0, "all are new");
    assert_eq!(sweep_older_than(&store, -3600).await.unwrap(), 3, "one upload, two objects of a result");
    let left: Vec<String> =
        place.objects.list("sessions").await.unwrap().into_iter().map(|object| object.key).collect();
    assert_eq!(left, ["sessions/s"]);
    assert!(place.objects.list("results").await.unwrap().is_empty());
}
