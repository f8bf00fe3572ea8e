//! Whether this process does what one of several must; see `leader`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether this process is the leader; clones share it.
#[derive(Debug, Clone)]
pub(super) struct Leadership(Arc<AtomicBool>);

impl Leadership {
    /// `is_alone`: no other process shares the database.
    pub(super) fn new(is_alone: bool) -> Self {
        Self(Arc::new(AtomicBool::new(is_alone)))
    }

    /// Notes that this process is the leader from now on, or no longer.
    #[cfg(feature = "scale")]
    pub(super) fn set(&self, is_held: bool) {
        self.0.store(is_held, Ordering::Relaxed);
    }

    /// Whether this process is the leader now.
    pub(super) fn is_held(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
