//! The claims that the workers of this process hold. A running job of this process that no worker holds is a stray: its claim
//! was committed, but the answer to the COMMIT was lost. It returns to the queue without a restart.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The fences of the held claims by job id.
#[derive(Debug, Default)]
pub(super) struct ActiveClaims {
    jobs: Mutex<BTreeMap<String, i64>>,
    may_have_strays: AtomicBool,
}

impl ActiveClaims {
    /// Notes a claim; must be called before its transaction is committed.
    pub(super) fn add(&self, job: &str, fence: i64) {
        self.jobs().insert(job.to_owned(), fence);
    }

    /// Forgets a claim whose outcome is recorded; a later claim of the same job stays.
    pub(super) fn remove(&self, job: &str, fence: i64) {
        let mut jobs = self.jobs();
        if jobs.get(job) == Some(&fence) {
            jobs.remove(job);
        }
    }

    /// Forgets a claim that may or may not have been committed.
    pub(super) fn lose(&self, job: &str, fence: i64) {
        self.remove(job, fence);
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
        serde_json::json!(self.jobs().keys().collect::<Vec<_>>()).to_string()
    }

    fn jobs(&self) -> MutexGuard<'_, BTreeMap<String, i64>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
