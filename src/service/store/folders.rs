//! File layout of a data folder, and how a file is made durable.
//!
//! `wandless.db` with its write-ahead log and `wandless.db.pages`, `wandless.db.new` (while it is created), `lock`, `reserve`, `tmp/` (unfinished uploads), `sessions/<id>`,
//! `results/<job>/<fence>/` (published), `results/<job>/<fence>.tmp/` (being written by a child process), `checkpoints/<job>/`
//! (finished stages of an open job). File names are generated here, never taken from a client.

use super::error::StoreError;
use super::private;
use super::random::new_id;
use crate::service::failpoint::{failpoint, fault};
use rustix::fs::FlockOperation;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Name of the database in a data folder and in a backup.
pub const DATABASE: &str = "wandless.db";

/// Name of the page digests in a data folder.
pub(super) const PAGES: &str = "wandless.db.pages";

/// A file without content that is removed when the disk is full, so that deletes still work.
const RESERVE: &str = "reserve";

/// Size of the reserve: enough for the write-ahead log of some thousand deletes.
const RESERVE_BYTES: usize = 2 << 20;

/// Paths of a data folder; a process that owns the folder holds its lock as long as a clone exists.
#[derive(Debug, Clone)]
pub struct Folders {
    root: PathBuf,
    /// `None` in a command beside a service that holds the lock.
    lock: Option<Arc<File>>,
}

/// A file that is removed on drop unless it was kept.
#[derive(Debug)]
pub struct TemporaryFile {
    /// Path of the file.
    pub path: PathBuf,
    kept: bool,
}

impl Folders {
    /// Creates the folders and takes the lock.
    ///
    /// # Errors
    /// [`StoreError::InUse`] when another process holds the lock, [`StoreError::Folder`] for other failures.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        for folder in ["", "tmp", "sessions", "results", "checkpoints"] {
            let path = root.join(folder);
            std::fs::create_dir_all(&path).map_err(|source| StoreError::Folder { path, source })?;
        }
        let fail = |path: &Path, source| StoreError::Folder { path: path.to_owned(), source };
        let root = root.canonicalize().map_err(|source| fail(root, source))?; // child processes may have another working folder
        restrict(&root);
        let path = root.join("lock");
        let lock =
            File::options().create(true).append(true).mode(0o600).open(&path).map_err(|source| fail(&path, source))?;
        match take_lock(&lock) {
            Ok(()) => Ok(Self { root, lock: Some(Arc::new(lock)) }),
            Err(_) if fault("lock.none") => Ok(Self { root, lock: Some(Arc::new(lock)) }),
            Err(rustix::io::Errno::WOULDBLOCK) => Err(StoreError::InUse { path }),
            Err(errno) => Err(StoreError::Folder { path, source: errno.into() }),
        }
    }

    /// Whether a running service owns a data folder.
    pub(crate) fn are_in_use(root: &Path) -> bool {
        let lock = File::open(root.join("lock"));
        let taken = lock.map(|lock| rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive));
        matches!(taken, Ok(Err(rustix::io::Errno::WOULDBLOCK))) // a lock taken here is released with the file
    }

    /// Returns the folders of a running service, for a command beside it.
    ///
    /// # Errors
    /// When the folder does not exist.
    pub(super) fn beside(root: &Path) -> Result<Self, StoreError> {
        let root = root.canonicalize().map_err(|source| StoreError::Folder { path: root.to_owned(), source })?;
        Ok(Self { root, lock: None })
    }

    /// Whether this process owns the folder.
    pub(super) fn are_owned(&self) -> bool {
        self.lock.is_some()
    }

    /// Path of the page digests.
    pub(super) fn pages(&self) -> PathBuf {
        self.root.join(PAGES)
    }

    /// Path of the database's write-ahead log.
    pub(super) fn log(&self) -> PathBuf {
        self.root.join("wandless.db-wal")
    }

    /// Path of the database file.
    pub fn database(&self) -> PathBuf {
        self.root.join(DATABASE)
    }

    /// Path of the database while it is created.
    pub(super) fn new_database(&self) -> PathBuf {
        self.root.join("wandless.db.new")
    }

    /// Folder of the registered body models.
    pub fn bodies(&self) -> PathBuf {
        crate::service::bodies::folder(&self.root)
    }

    /// Path of the uploaded bytes of a session.
    pub fn session(&self, id: &str) -> PathBuf {
        self.root.join("sessions").join(id)
    }

    /// Folder of all results of a job.
    pub fn job(&self, job: &str) -> PathBuf {
        self.root.join("results").join(job)
    }

    /// Folder of the checkpoints of an open job.
    pub fn checkpoints(&self, job: &str) -> PathBuf {
        self.root.join("checkpoints").join(job)
    }

    /// Folder of the published result of one claim.
    pub fn result(&self, job: &str, fence: i64) -> PathBuf {
        self.job(job).join(fence.to_string())
    }

    /// Folder in which a child process writes the result of one claim.
    pub fn staging(&self, job: &str, fence: i64) -> PathBuf {
        self.job(job).join(format!("{fence}.tmp"))
    }

    /// Folder of the local copies of objects.
    #[cfg(feature = "scale")]
    pub(super) fn cache(&self) -> PathBuf {
        self.root.join("cache")
    }

    /// Path of a folder in `tmp/`, which the next start clears.
    #[cfg(feature = "scale")]
    pub(super) fn scratch(&self, name: &str) -> PathBuf {
        self.root.join("tmp").join(name)
    }

    /// Returns a new path in `tmp/`.
    pub fn temporary(&self) -> TemporaryFile {
        TemporaryFile { path: self.root.join("tmp").join(new_id("upload")), kept: false }
    }

    /// Whether the folder contains any upload or result.
    pub(super) fn hold_files(&self) -> Result<bool, StoreError> {
        Ok(!self.names("sessions")?.is_empty() || !self.names("results")?.is_empty())
    }

    /// Lists the names in `tmp`, `sessions`, `results` or `checkpoints`, sorted.
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

    /// Removes one entry of `tmp`, `sessions`, `results` or `checkpoints`, folder or file. A missing entry is not an error.
    pub fn remove(&self, folder: &str, name: &str) {
        let path = self.root.join(folder).join(name);
        let removed = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        if let Err(error) = removed
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!(path = %path.display(), %error, "cannot be removed; the next start tries again");
        }
    }

    /// Removes what one claim of a job has written, and the job's folder where nothing else is in it.
    pub fn remove_claim(&self, job: &str, fence: i64) {
        self.remove("results", &format!("{job}/{fence}.tmp"));
        self.remove("results", &format!("{job}/{fence}"));
        let _ = std::fs::remove_dir(self.job(job)); // fails while files of another claim exist
    }

    /// Creates the reserve file, which is removed when the disk is full.
    pub(super) fn create_reserve(&self) {
        let path = self.root.join(RESERVE);
        if path.exists() {
            return;
        }
        let written = private::create_file(&path).and_then(|file| allocate(file, RESERVE_BYTES));
        if let Err(error) = written {
            tracing::warn!(%error, "cannot create the reserve file for a full disk");
            self.release_reserve();
        }
    }

    /// Removes the reserve file.
    pub(super) fn release_reserve(&self) {
        let _ = std::fs::remove_file(self.root.join(RESERVE)); // a missing file was released before
    }

    /// Returns the free bytes of the disk that this process may use.
    ///
    /// # Errors
    /// When the system does not report them.
    pub fn free_bytes(&self) -> io::Result<u64> {
        let disk = rustix::fs::statvfs(&self.root)?;
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
    }
}

/// Takes space of the disk for a file; where the file system cannot reserve it, by writing zeros.
fn allocate(mut file: File, bytes: usize) -> io::Result<()> {
    use rustix::io::Errno;
    match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, bytes as u64) {
        Err(Errno::OPNOTSUPP | Errno::NOSYS | Errno::INVAL) => file.write_all(&vec![0; bytes]),
        allocated => Ok(allocated?),
    }
}

/// Takes the rights of group and others from a data folder and its files beside `sessions/` and the like.
fn restrict(root: &Path) {
    let files = ["", DATABASE, "wandless.db-wal", "wandless.db-shm", PAGES, RESERVE, "lock"];
    for path in files.map(|name| root.join(name)) {
        if let Err(error) = private::restrict(&path) {
            tracing::warn!(path = %path.display(), %error, "other users of this machine may be able to read the data");
        }
    }
}

impl TemporaryFile {
    /// Makes the file durable under its final name.
    ///
    /// # Errors
    /// When the file cannot be synced or renamed; it is then removed.
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
            let _ = std::fs::remove_file(&self.path); // on failure the next start clears `tmp/`
        }
    }
}

/// How long to wait for the lock: if a service is killed while it starts a child process, the child holds the inherited
/// lock until it has replaced itself with the other program.
const LOCK_TIMEOUT: Duration = Duration::from_millis(500);

fn take_lock(lock: &File) -> rustix::io::Result<()> {
    let deadline = Instant::now() + LOCK_TIMEOUT;
    loop {
        match rustix::fs::flock(lock, FlockOperation::NonBlockingLockExclusive) {
            Err(rustix::io::Errno::WOULDBLOCK) if Instant::now() < deadline => {
                std::thread::sleep(Duration::from_millis(10));
            }
            taken => return taken,
        }
    }
}

/// Renames a synced file or folder and makes the new name durable.
///
/// # Errors
/// When renaming or syncing fails.
pub fn publish(from: &Path, to: &Path) -> io::Result<()> {
    std::fs::rename(from, to)?;
    failpoint("publish.renamed");
    match to.parent() {
        Some(parent) if parent == Path::new("") => File::open(".")?.sync_all(),
        Some(parent) => File::open(parent)?.sync_all(),
        None => Ok(()),
    }
}
