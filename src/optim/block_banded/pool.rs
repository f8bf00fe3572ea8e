//! Systems that were used up, whose memory the next ones take: a fresh system of a few hundred frames is 60 MB of pages that the kernel
//! has to clear.

use super::BlockBanded;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Memory of systems, shared by threads. It holds as many as were in use at once.
#[derive(Debug, Default)]
pub struct SystemPool(Mutex<Vec<BlockBanded>>);

impl SystemPool {
    /// A system of any size; it wants [`BlockBanded::reset`].
    pub fn take(&self) -> BlockBanded {
        self.free().pop().unwrap_or_default()
    }

    /// Keeps the memory of systems that were used up.
    pub fn put_back(&self, systems: impl IntoIterator<Item = BlockBanded>) {
        self.free().extend(systems);
    }

    fn free(&self) -> MutexGuard<'_, Vec<BlockBanded>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
