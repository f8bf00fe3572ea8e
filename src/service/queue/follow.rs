//! Changes of jobs as requests and workers follow them. A change of this process is sent at once; where several processes share the
//! database, a change of another one comes by a notification, or by the read of all followed jobs once a second.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

/// Number of followers by job.
#[derive(Debug, Default)]
pub(super) struct Followed {
    jobs: Mutex<BTreeMap<Arc<str>, usize>>,
}

impl Followed {
    fn jobs(&self) -> MutexGuard<'_, BTreeMap<Arc<str>, usize>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ids of the followed jobs.
    #[cfg(feature = "scale")]
    pub(super) fn ids(&self) -> Vec<Arc<str>> {
        self.jobs().keys().cloned().collect()
    }
}

/// The changes of one job.
#[derive(Debug)]
pub struct Following {
    job: Arc<str>,
    changes: broadcast::Receiver<Arc<str>>,
    followed: Arc<Followed>,
}

impl Following {
    /// Follows the changes of a job from now on.
    pub(super) fn new(job: &str, changes: broadcast::Receiver<Arc<str>>, followed: Arc<Followed>) -> Self {
        let job: Arc<str> = job.into();
        *followed.jobs().entry(job.clone()).or_default() += 1;
        Self { job, changes, followed }
    }

    /// Waits until the row of the job may have changed; false if there will be no more changes.
    pub async fn changed(&mut self) -> bool {
        loop {
            match self.changes.recv().await {
                Ok(changed) if *changed != *self.job => {}
                Ok(_) | Err(RecvError::Lagged(_)) => return true,
                Err(RecvError::Closed) => return false,
            }
        }
    }
}

impl Drop for Following {
    fn drop(&mut self) {
        let mut jobs = self.followed.jobs();
        if let Some(followers) = jobs.get_mut(&self.job) {
            *followers -= 1;
            if *followers == 0 {
                jobs.remove(&self.job);
            }
        }
    }
}
