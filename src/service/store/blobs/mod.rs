//! Where uploads, results and checkpoints are kept: in the data folder, or in an object store (feature `scale`).
//!
//! Files are always written in the data folder first and read from a local path. With an object store a finished file is then
//! handed over under a key that is never used again, and read through a local cache that compares the SHA-256 before it gives a
//! path. So results, ranges, inspections and child processes know files only.
//!
//! Keys: `sessions/<id>`, `results/<job>/<fence>/<sha256>`, `checkpoints/<job>/<stage>.ckpt`. No name of a client is in a key, and
//! no two claims share one: what is published follows from the row alone, and no conditional put is needed, which some stores
//! ignore.

#[cfg(feature = "scale")]
mod cache;
#[cfg(feature = "scale")]
mod checked;
pub(crate) mod local;
#[cfg(feature = "scale")]
mod objects;
#[cfg(feature = "scale")]
mod remote;
#[cfg(feature = "scale")]
pub(crate) mod strays;
#[cfg(test)]
#[cfg(feature = "scale")]
mod tests;
#[cfg(feature = "scale")]
mod versions;

use super::error::StoreError;
use super::folders::Folders;
use super::published::Artifact;
use crate::service::settings::BlobSettings;
#[cfg(feature = "scale")]
pub(crate) use checked::Checked;
use local::{LocalFile, LocalResult};

/// The value of `blobs.url` that keeps everything in the data folder.
pub(crate) const IN_FOLDER: &str = "file:";

/// Where uploads, results and checkpoints are kept; clones share it.
#[derive(Debug, Clone)]
pub(crate) enum Blobs {
    /// In the data folder.
    Folder(Folders),
    /// In an object store; the data folder holds what is being written, and the cache.
    #[cfg(feature = "scale")]
    Remote(remote::Remote),
}

impl Blobs {
    /// Opens the store that the settings name, and checks that it can be read and written.
    ///
    /// # Errors
    /// When the URL is not understood, this program cannot use it, or the store does not answer.
    pub(super) async fn open(settings: &BlobSettings, folders: &Folders) -> Result<Self, StoreError> {
        if settings.url == IN_FOLDER {
            return Ok(Self::Folder(folders.clone()));
        }
        #[cfg(feature = "scale")]
        return Ok(Self::Remote(remote::Remote::open(settings, folders).await?));
        #[cfg(not(feature = "scale"))]
        Err(StoreError::without_scale("blobs.url", &settings.url, IN_FOLDER))
    }

    /// Whether files are kept outside the data folder.
    pub(crate) fn are_remote(&self) -> bool {
        !matches!(self, Self::Folder(_))
    }

    /// Hands over the upload `sessions/<id>` of the data folder.
    ///
    /// # Errors
    /// When the object store fails; the file in the data folder is removed then.
    pub(crate) async fn take_session(&self, id: &str, sha256: &str) -> Result<(), StoreError> {
        match self {
            Self::Folder(_) => {
                let _ = (id, sha256);
                Ok(())
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.take_session(id, sha256).await,
        }
    }

    /// A path of an uploaded file.
    ///
    /// # Errors
    /// When the object store fails or gives other bytes.
    pub(crate) async fn session(&self, id: &str, sha256: &str) -> Result<LocalFile, StoreError> {
        match self {
            Self::Folder(folders) => {
                let _ = sha256;
                Ok(LocalFile::in_folder(folders.session(id)))
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.session(id, sha256).await,
        }
    }

    /// Hands over the folder `results/<job>/<fence>` of the data folder.
    ///
    /// # Errors
    /// When the object store fails; the folder in the data folder stays then.
    pub(crate) async fn take_result(&self, job: &str, fence: i64, files: &[Artifact]) -> Result<(), StoreError> {
        match self {
            Self::Folder(_) => {
                let _ = (job, fence, files);
                Ok(())
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.take_result(job, fence, files).await,
        }
    }

    /// Stores a file of another data folder under its key, and compares what the store has then with the digest. Returns whether it
    /// was there already.
    ///
    /// # Errors
    /// When the object store fails or gives other bytes.
    #[cfg(feature = "scale")]
    pub(crate) async fn import(&self, key: &str, file: &std::path::Path, sha256: &str) -> Result<bool, StoreError> {
        match self {
            Self::Folder(_) => Ok(true), // settings with a server name another store
            Self::Remote(remote) => remote.import(key, file, sha256).await,
        }
    }

    /// Fails unless the object store keeps versions of objects.
    ///
    /// # Errors
    /// [`StoreError::Unversioned`], or when the object store fails.
    #[cfg(feature = "scale")]
    pub(crate) async fn require_versions(&self) -> Result<(), StoreError> {
        match self {
            Self::Folder(_) => Err(StoreError::Unversioned { reason: "the files are in the data folder".to_owned() }),
            Self::Remote(remote) => remote.require_versions().await,
        }
    }

    /// Reads an object and compares its digest; with `undelete`, a version with that digest takes the place of a missing or damaged one.
    ///
    /// # Errors
    /// When the object store fails.
    #[cfg(feature = "scale")]
    pub(crate) async fn check(&self, key: &str, sha256: &str, undelete: bool) -> Result<Checked, StoreError> {
        match self {
            Self::Folder(_) => Ok(Checked::Damaged), // settings with a server name another store
            Self::Remote(remote) => remote.check(key, sha256, undelete).await,
        }
    }

    /// A path of one published file.
    ///
    /// # Errors
    /// When the object store fails or gives other bytes.
    pub(crate) async fn artifact(&self, job: &str, fence: i64, file: &Artifact) -> Result<LocalFile, StoreError> {
        match self {
            Self::Folder(folders) => Ok(LocalFile::in_folder(folders.result(job, fence).join(&file.name))),
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.artifact(job, fence, file).await,
        }
    }

    /// A folder with all published files of a job under their names.
    ///
    /// # Errors
    /// When the object store or the disk fails.
    pub(crate) async fn result(&self, job: &str, fence: i64, files: &[Artifact]) -> Result<LocalResult, StoreError> {
        match self {
            Self::Folder(folders) => {
                let _ = files;
                Ok(LocalResult::in_folder(folders.result(job, fence)))
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.result(job, fence, files).await,
        }
    }

    /// Drops the local copy of a file that was found damaged; true if another copy can be fetched.
    pub(crate) fn forget(&self, sha256: &str) -> bool {
        match self {
            Self::Folder(_) => {
                let _ = sha256;
                false
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.forget(sha256),
        }
    }

    /// Brings the checkpoints of a job that another worker has handed over into the data folder.
    pub(crate) async fn fetch_checkpoints(&self, job: &str) {
        match self {
            Self::Folder(_) => {
                let _ = job;
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.fetch_checkpoints(job).await,
        }
    }

    /// Hands over the checkpoints of a job that were written since the last call. `kept`: their names.
    pub(crate) async fn keep_checkpoints(&self, job: &str, kept: &mut std::collections::BTreeSet<String>) {
        match self {
            Self::Folder(_) => {
                let _ = (job, kept);
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.keep_checkpoints(job, kept).await,
        }
    }

    /// Removes everything below a folder of the object store, as `Folders::remove` does in the data folder. A failure is logged;
    /// the sweep removes what stays.
    pub(super) async fn remove(&self, folder: &str) {
        match self {
            Self::Folder(_) => {
                let _ = folder;
            }
            #[cfg(feature = "scale")]
            Self::Remote(remote) => remote.remove(folder).await,
        }
    }
}
