//! Uploads, results and checkpoints in an object store, with local copies.

use super::super::error::StoreError;
use super::super::folders::Folders;
use super::super::published::Artifact;
use super::super::random::new_id;
use super::cache::Cache;
use super::checked::Checked;
use super::local::{Assembled, LocalFile, LocalResult};
use super::objects::{Listed, Objects};
use crate::service::settings::BlobSettings;
use futures_util::{StreamExt, TryStreamExt};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Objects that are fetched or stored at the same time, for each folder.
const AT_ONCE: usize = 4;

/// Fetches of one process at the same time.
const FETCHES: usize = 8;

/// Fetches of an object that came with other bytes: what was damaged on its way is right the next time, and a job whose session is
/// damaged fails for good.
const MAX_FETCHES: usize = 3;

/// The object store of a service process; clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Remote {
    pub(super) objects: Objects,
    cache: Cache,
    folders: Folders,
    fetches: Arc<Semaphore>,
}

fn session_key(id: &str) -> String {
    format!("sessions/{id}")
}

fn result_key(job: &str, fence: i64, sha256: &str) -> String {
    format!("results/{job}/{fence}/{sha256}")
}

fn checkpoint_folder(job: &str) -> String {
    format!("checkpoints/{job}")
}

impl Remote {
    pub(super) async fn open(settings: &BlobSettings, folders: &Folders) -> Result<Self, StoreError> {
        let remote = Self::new(Objects::open(&settings.url)?, settings.cache_bytes, folders)?;
        remote.objects.now().await?;
        Ok(remote)
    }

    pub(super) fn new(objects: Objects, cache_bytes: u64, folders: &Folders) -> Result<Self, StoreError> {
        let place = folders.cache();
        let cache =
            Cache::open(place.clone(), cache_bytes).map_err(|source| StoreError::Folder { path: place, source })?;
        Ok(Self { objects, cache, folders: folders.clone(), fetches: Arc::new(Semaphore::new(FETCHES)) })
    }

    pub(super) async fn take_session(&self, id: &str, sha256: &str) -> Result<(), StoreError> {
        let file = self.folders.session(id);
        let stored = self.objects.put_file(&session_key(id), &file).await;
        let (cache, sha256) = (self.cache.clone(), sha256.to_owned());
        let is_stored = stored.is_ok();
        blocking(move || {
            if !is_stored || cache.adopt(&file, &sha256).is_err() {
                let _ = std::fs::remove_file(&file); // the next start clears `sessions/`
            }
            Ok(())
        })
        .await
        .map_err(|source| StoreError::Folder { path: self.folders.session(id), source })?;
        stored
    }

    pub(super) async fn session(&self, id: &str, sha256: &str) -> Result<LocalFile, StoreError> {
        self.local(&session_key(id), sha256).await
    }

    pub(super) async fn take_result(&self, job: &str, fence: i64, files: &[Artifact]) -> Result<(), StoreError> {
        let folder = self.folders.result(job, fence);
        // Files of the same bytes are one object.
        let by_sha256: BTreeMap<&String, &Artifact> = files.iter().map(|file| (&file.sha256, file)).collect();
        let puts: Vec<_> = by_sha256
            .into_values()
            .map(|file| {
                let (remote, key) = (self.clone(), result_key(job, fence, &file.sha256));
                let (path, sha256) = (folder.join(&file.name), file.sha256.clone());
                async move {
                    remote.objects.put_file(&key, &path).await?;
                    let _ = remote.cache.adopt(&path, &sha256); // a result without a local copy is fetched
                    Ok::<_, StoreError>(())
                }
            })
            .collect();
        futures_util::stream::iter(puts).buffer_unordered(AT_ONCE).try_collect::<()>().await?;
        self.folders.remove_claim(job, fence);
        Ok(())
    }

    pub(super) async fn import(&self, key: &str, file: &Path, sha256: &str) -> Result<bool, StoreError> {
        if self.has(key, sha256).await? {
            return Ok(true);
        }
        self.objects.put_file(key, file).await?;
        match self.has(key, sha256).await? {
            true => Ok(false),
            false => Err(damaged(key)),
        }
    }

    /// Whether the object is there with these bytes, all of which are read.
    pub(super) async fn has(&self, key: &str, sha256: &str) -> Result<bool, StoreError> {
        match self.objects.digest(key).await {
            Ok(found) => Ok(found == sha256),
            Err(StoreError::BlobDamaged { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Whether the object store keeps versions of objects.
    pub(super) async fn require_versions(&self) -> Result<(), StoreError> {
        let reason = match &self.objects.versions {
            None => "the objects are files of a folder, which has no versions",
            Some(versions) if versions.are_kept().await? => return Ok(()),
            Some(_) => "the bucket keeps no versions; switch its versioning on",
        };
        Err(StoreError::Unversioned { reason: reason.to_owned() })
    }

    pub(super) async fn check(&self, key: &str, sha256: &str, undelete: bool) -> Result<Checked, StoreError> {
        if self.has(key, sha256).await? {
            return Ok(Checked::Whole);
        }
        let Some(versions) = self.objects.versions.as_ref().filter(|_| undelete) else { return Ok(Checked::Damaged) };
        for version in versions.of(key).await? {
            let file = self.folders.temporary();
            if self.objects.get_version(key, version, &file.path).await.is_ok_and(|found| found == sha256) {
                self.objects.put_file(key, &file.path).await?;
                return Ok(Checked::Restored);
            }
        }
        Ok(Checked::Damaged)
    }

    pub(super) async fn artifact(&self, job: &str, fence: i64, file: &Artifact) -> Result<LocalFile, StoreError> {
        self.local(&result_key(job, fence, &file.sha256), &file.sha256).await
    }

    pub(super) async fn result(&self, job: &str, fence: i64, files: &[Artifact]) -> Result<LocalResult, StoreError> {
        let folder = Assembled(self.folders.scratch(&new_id("result")));
        let gets: Vec<_> = files
            .iter()
            .map(|file| {
                let (remote, job, file) = (self.clone(), job.to_owned(), file.clone());
                let path = folder.0.join(&file.name);
                async move { Ok::<_, StoreError>((remote.artifact(&job, fence, &file).await?, path)) }
            })
            .collect();
        let copies: Vec<(LocalFile, PathBuf)> =
            futures_util::stream::iter(gets).buffer_unordered(AT_ONCE).try_collect().await?;
        let path = folder.0.clone();
        let linked = blocking(move || copies.iter().try_for_each(|(copy, path)| link(&copy.path, path))).await;
        linked.map_err(|source| StoreError::Folder { path: path.clone(), source })?;
        Ok(LocalResult { path, copy: Some(folder) })
    }

    pub(super) fn forget(&self, sha256: &str) -> bool {
        self.cache.forget(sha256);
        true
    }

    pub(super) async fn fetch_checkpoints(&self, job: &str) {
        let fetched = async {
            let folder = self.folders.checkpoints(job);
            for Listed { key, .. } in self.objects.list(&checkpoint_folder(job)).await? {
                // A checkpoint proves itself by its key and its digest when it is read.
                let Some(name) = key.rsplit('/').next() else { continue };
                let file = self.folders.temporary();
                self.objects.get_file(&key, &file.path).await?;
                let moved =
                    std::fs::create_dir_all(&folder).and_then(|()| std::fs::rename(&file.path, folder.join(name)));
                moved.map_err(|source| StoreError::Folder { path: folder.join(name), source })?;
            }
            Ok::<_, StoreError>(())
        };
        if let Err(error) = fetched.await {
            tracing::warn!(%error, "checkpoints cannot be fetched; their stages are run again");
        }
    }

    pub(super) async fn keep_checkpoints(&self, job: &str, kept: &mut BTreeSet<String>) {
        let names = self.folders.names(&checkpoint_folder(job)).unwrap_or_default(); // without a folder there are none
        for name in names.into_iter().filter(|name| name.ends_with(".ckpt")) {
            if kept.contains(&name) {
                continue;
            }
            let file = self.folders.checkpoints(job).join(&name);
            match self.objects.put_file(&format!("{}/{name}", checkpoint_folder(job)), &file).await {
                Ok(()) => _ = kept.insert(name),
                Err(error) => tracing::warn!(%error, "a checkpoint cannot be stored; trying again"),
            }
        }
    }

    pub(super) async fn remove(&self, folder: &str) {
        let removed = async {
            let mut keys: Vec<String> = self.objects.list(folder).await?.into_iter().map(|object| object.key).collect();
            if folder.starts_with("sessions/") {
                keys.push(folder.to_owned()); // an object, not a folder
            }
            for key in keys {
                self.objects.remove(&key).await?;
            }
            Ok::<_, StoreError>(())
        };
        if let Err(error) = removed.await {
            tracing::warn!(%error, folder, "objects cannot be removed; the sweep removes them");
        }
    }

    /// The cached copy of an object, fetched if there is none.
    async fn local(&self, key: &str, sha256: &str) -> Result<LocalFile, StoreError> {
        if let Some(copy) = self.cached(sha256).await {
            return Ok(copy);
        }
        let _turn = self.fetches.acquire().await; // never closed
        if let Some(copy) = self.cached(sha256).await {
            return Ok(copy); // another request has fetched it meanwhile
        }
        for _ in 0..MAX_FETCHES {
            let file = self.folders.temporary();
            if self.objects.get_file(key, &file.path).await? == sha256 {
                let adopted = self.cache.adopt(&file.path, sha256);
                let (path, pin) = adopted.map_err(|source| StoreError::Folder { path: file.path.clone(), source })?;
                return Ok(LocalFile { path, pin: Some(pin) });
            }
        }
        Err(damaged(key))
    }

    async fn cached(&self, sha256: &str) -> Option<LocalFile> {
        let (cache, sha256) = (self.cache.clone(), sha256.to_owned());
        let found = blocking(move || Ok(cache.get(&sha256))).await;
        found.ok().flatten().map(|(path, pin)| LocalFile { path, pin: Some(pin) })
    }
}

fn damaged(key: &str) -> StoreError {
    StoreError::BlobDamaged { key: key.to_owned(), reason: "the digest differs from the stored one" }
}

/// Gives a file a second name; copies it on file systems without links.
fn link(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    std::fs::hard_link(from, to).or_else(|_| std::fs::copy(from, to).map(drop))
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> io::Result<T> + Send + 'static) -> io::Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(io::Error::other)?
}
