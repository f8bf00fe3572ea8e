//! Finished inspections, and the turns of those to come.
//!
//! An inspection follows from the bytes of the session alone, so it is kept by their digest. It holds a whole session in
//! memory, as the validation of an upload does; one at a time leaves the other permit to uploads.

use super::turns::Turns;
use axum::body::Bytes;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;

/// Largest total size of the kept documents, bytes; one has about 20 kB with 8 cameras.
const MAX_BYTES: usize = 16 << 20;

/// Longest wait for the other inspections of the same tenant: one of a long capture takes some seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// Inspections of all tenants.
#[derive(Debug)]
pub(super) struct Inspections {
    /// Digest of the session and its inspection as JSON, the longest unused first.
    finished: Mutex<VecDeque<(String, Bytes)>>,
    /// Each tenant waits for its own inspections only, and for one of every other tenant.
    pub(super) tenants: Turns,
    /// One inspection at a time.
    pub(super) turn: Arc<Semaphore>,
}

impl Default for Inspections {
    fn default() -> Self {
        Self {
            finished: Mutex::default(),
            tenants: Turns::new(1).with_patience(PATIENCE),
            turn: Arc::new(Semaphore::new(1)),
        }
    }
}

impl Inspections {
    /// The inspection of the session with this digest.
    pub(super) fn get(&self, sha256: &str) -> Option<Bytes> {
        let mut finished = self.finished.lock().unwrap_or_else(PoisonError::into_inner);
        let at = finished.iter().position(|(kept, _)| kept == sha256)?;
        let found = finished.remove(at)?;
        let document = found.1.clone();
        finished.push_back(found);
        Some(document)
    }

    /// Keeps an inspection; the longest unused ones are dropped where all together are too large.
    pub(super) fn insert(&self, sha256: String, document: Bytes) {
        let mut finished = self.finished.lock().unwrap_or_else(PoisonError::into_inner);
        finished.retain(|(kept, _)| *kept != sha256);
        finished.push_back((sha256, document));
        let mut bytes: usize = finished.iter().map(|(_, document)| document.len()).sum();
        while bytes > MAX_BYTES {
            bytes -= finished.pop_front().map_or(bytes, |(_, document)| document.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_unused_inspection_is_dropped() {
        let inspections = Inspections::default();
        let document = Bytes::from(vec![b' '; MAX_BYTES / 2]);
        inspections.insert("a".to_owned(), document.clone());
        inspections.insert("b".to_owned(), document.clone());
        assert!(inspections.get("a").is_some());
        inspections.insert("c".to_owned(), document);
        assert_eq!(["a", "b", "c"].map(|sha256| inspections.get(sha256).is_some()), [true, false, true]);
        inspections.insert("d".to_owned(), Bytes::from(vec![b' '; MAX_BYTES + 1]));
        assert_eq!(["a", "c", "d"].map(|sha256| inspections.get(sha256).is_some()), [false; 3]);
    }
}
