//! The claims that the workers of this process hold. A running job of this process that no worker holds is a stray: its claim
//! was committed, but the answer to the COMMIT was lost. It returns to the queue without a restart.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The held claims by job id.
#[derive(Debug, Default)]
pub(super) struct ActiveClaims {
    jobs: Mutex<BTreeSet<String>>,
    may_have_strays: AtomicBool,
}

impl ActiveClaims {
    /// Notes a claim; must be called before its transaction is committed.
    pub(super) fn add(&self, job: &str) {
        self.jobs().insert(job.to_owned());
    }

    /// Forgets a claim whose outcome is recorded.
    pub(super) fn remove(&self, job: &str) {
        self.jobs().remove(job);
    }

    /// Forgets a claim that may or may not have been committed.
    pub(super) fn lose(&self, job: &str) {
        self.remove(job);
        self.note_strays();
    }

    /// Notes that the database may have strays.
    pub(super) fn note_strays(&self) {
        self.may_have_strays.store(true, Ordering::Relaxed);
    }

    /// Whether strays were noted since the last call.
    pub(super) fn take_strays(&self) -> bool {
        self.may_have_strays.swap(false, Ordering::Relaxed)
    }

    /// The ids of the held jobs as a JSON list.
    pub(super) fn as_json(&self) -> String {
        serde_json::json!(&*self.jobs()).to_string()
    }

    fn jobs(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
