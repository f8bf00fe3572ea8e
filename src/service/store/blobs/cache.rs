//! Local copies of objects by their SHA-256. A copy of an earlier process is compared with its digest before it is used; copies
//! are removed, the longest unused first, when all together are too large.

use super::super::published::digest_file;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The copies; clones share them.
#[derive(Debug, Clone)]
pub(super) struct Cache {
    folder: PathBuf,
    max_bytes: u64,
    copies: Arc<Mutex<Copies>>,
}

#[derive(Debug, Default)]
struct Copies {
    by_sha256: BTreeMap<String, Copy>,
    /// Number of uses, the order of the last ones.
    uses: u64,
}

#[derive(Debug)]
struct Copy {
    bytes: u64,
    last_use: u64,
    /// Readers of the file.
    pins: usize,
    /// Whether this process has compared the digest.
    is_checked: bool,
}

/// Keeps a copy in the cache; released on drop.
#[derive(Debug)]
pub(crate) struct Pin {
    cache: Cache,
    sha256: String,
}

impl Drop for Pin {
    fn drop(&mut self) {
        if let Some(copy) = self.cache.copies().by_sha256.get_mut(&self.sha256) {
            copy.pins = copy.pins.saturating_sub(1);
        }
    }
}

impl Cache {
    /// Takes over the copies of an earlier process, which are compared before their first use.
    pub(super) fn open(folder: PathBuf, max_bytes: u64) -> std::io::Result<Self> {
        std::fs::create_dir_all(&folder)?;
        let mut copies = Copies::default();
        for entry in std::fs::read_dir(&folder)? {
            let entry = entry?;
            let copy = Copy { bytes: entry.metadata()?.len(), last_use: 0, pins: 0, is_checked: false };
            copies.by_sha256.insert(entry.file_name().to_string_lossy().into_owned(), copy);
        }
        let cache = Self { folder, max_bytes, copies: Arc::new(Mutex::new(copies)) };
        cache.evict();
        Ok(cache)
    }

    /// A copy whose digest was compared; blocks while it is.
    pub(super) fn get(&self, sha256: &str) -> Option<(PathBuf, Pin)> {
        let path = self.path(sha256);
        let pin = Pin { cache: self.clone(), sha256: sha256.to_owned() };
        let is_checked = {
            let mut copies = self.copies();
            copies.uses += 1;
            let uses = copies.uses;
            let copy = copies.by_sha256.get_mut(sha256)?;
            (copy.last_use, copy.pins) = (uses, copy.pins + 1);
            copy.is_checked
        };
        if is_checked && path.exists() {
            return Some((path, pin));
        }
        if digest_file(&path).is_ok_and(|digest| digest.sha256 == sha256) {
            if let Some(copy) = self.copies().by_sha256.get_mut(sha256) {
                copy.is_checked = true;
            }
            return Some((path, pin));
        }
        tracing::warn!(sha256, "a cached copy is damaged or missing; it is fetched again");
        drop(pin);
        self.forget(sha256);
        None
    }

    /// Takes over a file whose bytes have this digest. The name appears with the complete file.
    pub(super) fn adopt(&self, file: &Path, sha256: &str) -> std::io::Result<(PathBuf, Pin)> {
        let (path, bytes) = (self.path(sha256), std::fs::metadata(file)?.len());
        std::fs::rename(file, &path)?;
        {
            let mut copies = self.copies();
            copies.uses += 1;
            let last_use = copies.uses;
            let pins = copies.by_sha256.get(sha256).map_or(0, |copy| copy.pins) + 1;
            copies.by_sha256.insert(sha256.to_owned(), Copy { bytes, last_use, pins, is_checked: true });
        }
        self.evict();
        Ok((path, Pin { cache: self.clone(), sha256: sha256.to_owned() }))
    }

    /// Removes a copy; those that read it keep their open file.
    pub(super) fn forget(&self, sha256: &str) {
        self.copies().by_sha256.remove(sha256);
        let _ = std::fs::remove_file(self.path(sha256)); // a missing file is what is wanted
    }

    /// Removes the longest unused copies that have no reader while all together are too large.
    fn evict(&self) {
        loop {
            let longest_unused = {
                let copies = self.copies();
                let bytes: u64 = copies.by_sha256.values().map(|copy| copy.bytes).sum();
                let unused = copies.by_sha256.iter().filter(|(_, copy)| copy.pins == 0);
                let first = unused.min_by_key(|(_, copy)| copy.last_use).map(|(sha256, _)| sha256.clone());
                first.filter(|_| bytes > self.max_bytes)
            };
            let Some(sha256) = longest_unused else { return };
            self.forget(&sha256);
        }
    }

    fn path(&self, sha256: &str) -> PathBuf {
        self.folder.join(sha256)
    }

    fn copies(&self) -> MutexGuard<'_, Copies> {
        self.copies.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
