//! Space on the disk: the bytes that stay free, and the uploads that are still arriving.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Space rules of one service process; clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Space {
    /// Bytes of the disk that stay free.
    pub(super) min_free_bytes: u64,
    arriving: Arc<Mutex<Arriving>>,
}

/// Uploads that have no row yet.
#[derive(Debug, Default)]
pub(super) struct Arriving {
    /// Announced bytes of all uploads that are not yet on the disk.
    pub(super) unwritten: u64,
    /// Bytes that count towards the quota, by the name of the tenant.
    pub(super) by_tenant: BTreeMap<String, u64>,
}

impl Space {
    /// The uploads that are arriving.
    pub(super) fn arriving(&self) -> MutexGuard<'_, Arriving> {
        self.arriving.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
