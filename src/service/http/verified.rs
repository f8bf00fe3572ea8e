//! Published files whose digest was compared: a client that reads a file in parts must not make the service hash the whole
//! file for each part.

use std::collections::HashMap;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A file is hashed again after this time, although its times have not changed: the disk can fail silently.
const MAX_AGE: Duration = Duration::from_secs(600);
/// Largest number of remembered files, 200 bytes each.
const MAX_FILES: usize = 10_000;

/// Digests of files by their state at that time.
#[derive(Debug, Default)]
pub(super) struct VerifiedFiles {
    files: Mutex<HashMap<FileState, Verified>>,
}

/// Changes with every write to the file.
#[derive(Debug, PartialEq, Eq, Hash)]
struct FileState {
    device: u64,
    inode: u64,
    bytes: u64,
    /// Seconds and nanoseconds.
    modified: [i64; 2],
    /// Seconds and nanoseconds.
    changed: [i64; 2],
}

#[derive(Debug)]
struct Verified {
    sha256: String,
    at: Instant,
}

impl VerifiedFiles {
    /// Whether the file had this digest a short time ago and was not written since.
    pub(super) fn contain(&self, file: &Metadata, sha256: &str) -> bool {
        let files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        let verified = files.get(&FileState::of(file));
        verified.is_some_and(|verified| verified.sha256 == sha256 && verified.at.elapsed() < MAX_AGE)
    }

    /// Remembers the digest of a file; `file` is its state before it was read.
    pub(super) fn insert(&self, file: &Metadata, sha256: String) {
        let mut files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        if files.len() >= MAX_FILES {
            files.clear();
        }
        files.insert(FileState::of(file), Verified { sha256, at: Instant::now() });
    }
}

impl FileState {
    fn of(file: &Metadata) -> Self {
        Self {
            device: file.dev(),
            inode: file.ino(),
            bytes: file.len(),
            modified: [file.mtime(), file.mtime_nsec()],
            changed: [file.ctime(), file.ctime_nsec()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_file_must_be_verified_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("people.json");
        std::fs::write(&path, "{}").unwrap();
        let verified = VerifiedFiles::default();
        let before = std::fs::metadata(&path).unwrap();
        assert!(!verified.contain(&before, "a"));
        verified.insert(&before, "a".to_owned());
        assert!(verified.contain(&std::fs::metadata(&path).unwrap(), "a"));
        assert!(!verified.contain(&before, "b"));
        std::thread::sleep(Duration::from_millis(50)); // file times advance with the ticks of the kernel
        std::fs::write(&path, "[]").unwrap();
        assert!(!verified.contain(&std::fs::metadata(&path).unwrap(), "a"));
    }
}
