//! Where the files of a data folder lie, and how one is made durable.
//!
//! `wandless.db` with its log and `wandless.db.pages`, `lock`, `reserve`, `tmp/` (uploads on their way), `sessions/<id>`, `results/<job>/<fence>/` (published) and
//! `results/<job>/<fence>.tmp/` (being written by a child), `checkpoints/<job>/` (finished stages of a job at work). File names are made here, never taken from a client.

use super::StoreError;
use crate::service::failpoint::{failpoint, fault};
use rustix::fs::FlockOperation;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Name of the database in a data folder and in a backup.
pub const DATABASE: &str = "wandless.db";

/// A file of nothing, given up so that a full disk can be cleared.
const RESERVE: &str = "reserve";

/// Enough for the log of some thousand deletes.
const RESERVE_BYTES: usize = 2 << 20;

/// The folders of a data folder that this process owns: the lock is held as long as a clone lives.
#[derive(Debug, Clone)]
pub struct Folders {
    root: PathBuf,
    /// None beside a service that holds the lock.
    lock: Option<Arc<File>>,
}

/// A file that is removed when dropped, unless it was kept.
#[derive(Debug)]
pub struct TemporaryFile {
    /// Where it lies.
    pub path: PathBuf,
    kept: bool,
}

impl Folders {
    /// Makes the folders and takes the lock.
    ///
    /// # Errors
    /// [`StoreError::InUse`] when another process holds the lock, [`StoreError::Folder`] for the rest.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        for folder in ["", "tmp", "sessions", "results", "checkpoints"] {
            let path = root.join(folder);
            std::fs::create_dir_all(&path).map_err(|source| StoreError::Folder { path, source })?;
        }
        let fail = |path: &Path, source| StoreError::Folder { path: path.to_owned(), source };
        let root = root.canonicalize().map_err(|source| fail(root, source))?; // a child must find it from anywhere
        let path = root.join("lock");
        let lock = File::options().create(true).append(true).open(&path).map_err(|source| fail(&path, source))?;
        match take_lock(&lock) {
            Err(_) if fault("lock.none") => Ok(Self { root, lock: Some(Arc::new(lock)) }),
            Ok(()) => Ok(Self { root, lock: Some(Arc::new(lock)) }),
            Err(rustix::io::Errno::WOULDBLOCK) => Err(StoreError::InUse { path }),
            Err(errno) => Err(StoreError::Folder { path, source: errno.into() }),
        }
    }

    /// Whether a service is at work in a data folder.
    pub(crate) fn are_in_use(root: &Path) -> bool {
        let lock = File::options().append(true).open(root.join("lock"));
        let taken = lock.map(|lock| rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive));
        matches!(taken, Ok(Err(rustix::io::Errno::WOULDBLOCK))) // a lock that was taken goes with the file, here
    }

    /// The folders of a service that is at work, for a command beside it.
    ///
    /// # Errors
    /// When there is no such folder.
    pub(super) fn beside(root: &Path) -> Result<Self, StoreError> {
        let root = root.canonicalize().map_err(|source| StoreError::Folder { path: root.to_owned(), source })?;
        Ok(Self { root, lock: None })
    }

    /// Whether this process owns the folder.
    pub(super) fn are_owned(&self) -> bool {
        self.lock.is_some()
    }

    /// Digests of the database's pages.
    pub(super) fn pages(&self) -> PathBuf {
        self.root.join(super::pages::PAGES)
    }

    /// The database's write-ahead log.
    pub(super) fn log(&self) -> PathBuf {
        self.root.join("wandless.db-wal")
    }

    /// The database file.
    pub fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// The registered body models.
    pub fn bodies(&self) -> PathBuf {
        crate::service::bodies::folder(&self.root)
    }

    /// The bytes of a session.
    pub fn session(&self, id: &str) -> PathBuf {
        self.root.join("sessions").join(id)
    }

    /// All files of a job.
    pub fn job(&self, job: &str) -> PathBuf {
        self.root.join("results").join(job)
    }

    /// Finished stages of a job that has not ended.
    pub fn checkpoints(&self, job: &str) -> PathBuf {
        self.root.join("checkpoints").join(job)
    }

    /// The published result of one claim of a job.
    pub fn result(&self, job: &str, fence: i64) -> PathBuf {
        self.job(job).join(fence.to_string())
    }

    /// Where a child writes the result of one claim.
    pub fn staging(&self, job: &str, fence: i64) -> PathBuf {
        self.job(job).join(format!("{fence}.tmp"))
    }

    /// A new name in `tmp/`.
    pub fn temporary(&self) -> TemporaryFile {
        TemporaryFile { path: self.root.join("tmp").join(super::new_id("upload")), kept: false }
    }

    /// Whether any upload or result is there.
    pub(super) fn hold_files(&self) -> Result<bool, StoreError> {
        Ok(!self.names("sessions")?.is_empty() || !self.names("results")?.is_empty())
    }

    /// The names in `tmp`, `sessions`, `results` or `checkpoints`, sorted.
    ///
    /// # Errors
    /// When the folder cannot be read.
    pub fn names(&self, folder: &str) -> Result<Vec<String>, StoreError> {
        let path = self.root.join(folder);
        let entries: io::Result<Vec<_>> = std::fs::read_dir(&path).and_then(Iterator::collect);
        let entries = entries.map_err(|source| StoreError::Folder { path, source })?;
        let mut names: Vec<String> = entries.iter().map(|e| e.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        Ok(names)
    }

    /// Removes one name of `tmp`, `sessions`, `results` or `checkpoints`, folder or file. What is gone already is no error.
    pub fn remove(&self, folder: &str, name: &str) {
        let path = self.root.join(folder).join(name);
        let removed = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        if let Err(error) = removed
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!(path = %path.display(), %error, "could not be removed; the next start tries again");
        }
    }

    /// Removes what one claim of a job has written, and the job's folder where nothing else is in it.
    pub fn remove_claim(&self, job: &str, fence: i64) {
        self.remove("results", &format!("{job}/{fence}.tmp"));
        self.remove("results", &format!("{job}/{fence}"));
        let _ = std::fs::remove_dir(self.job(job)); // refuses while another claim's files are there
    }

    /// Fills a file that nobody needs, so that there is something to give up when the disk is full.
    pub(super) fn take_reserve(&self) {
        let path = self.root.join(RESERVE);
        if path.exists() {
            return;
        }
        if let Err(error) = std::fs::write(&path, vec![0; RESERVE_BYTES]) {
            tracing::warn!(%error, "no bytes could be kept back for a full disk");
            self.give_reserve_up();
        }
    }

    /// Removes that file.
    pub(super) fn give_reserve_up(&self) {
        let _ = std::fs::remove_file(self.root.join(RESERVE)); // given up already: then there is nothing to give
    }

    /// Bytes that the disk has left for us.
    ///
    /// # Errors
    /// When the system does not tell.
    pub fn free_bytes(&self) -> io::Result<u64> {
        let disk = rustix::fs::statvfs(&self.root)?;
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
    }
}

impl TemporaryFile {
    /// Makes the file durable under its final name.
    ///
    /// # Errors
    /// When it cannot be synced or renamed; it is removed then.
    pub fn keep_as(mut self, path: &Path) -> io::Result<()> {
        File::open(&self.path)?.sync_all()?;
        failpoint("upload.synced");
        publish(&self.path, path)?;
        failpoint("upload.published");
        self.kept = true;
        Ok(())
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        if !self.kept {
            let _ = std::fs::remove_file(&self.path); // nobody knows of it; the next start clears `tmp/`
        }
    }
}

/// How long a service is waited for that was killed while it started a child: until that child is another program, it
/// holds the lock along with everything else of its parent.
const LOCK_PATIENCE: Duration = Duration::from_millis(500);

fn take_lock(lock: &File) -> rustix::io::Result<()> {
    let deadline = Instant::now() + LOCK_PATIENCE;
    loop {
        match rustix::fs::flock(lock, FlockOperation::NonBlockingLockExclusive) {
            Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(10));
            }
            taken => return taken,
        }
    }
}

/// Renames what is already synced and makes the new name durable.
///
/// # Errors
/// When the system refuses either.
pub fn publish(from: &Path, to: &Path) -> io::Result<()> {
    std::fs::rename(from, to)?;
    failpoint("publish.renamed");
    match to.parent() {
        Some(parent) => File::open(parent)?.sync_all(),
        None => Ok(()),
    }
}
