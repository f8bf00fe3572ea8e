//! What a worker does beside its job in a service of several machines: it shows that the claim is alive, from the claim to the recorded
//! end, and hands over the checkpoints of finished stages.

#[cfg(feature = "scale")]
use crate::service::failpoint::fault;
use crate::service::queue::{Claim, Queue};
use crate::service::store::Store;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::task::JoinHandle;

/// Tasks of one claim; they end on drop.
pub(super) struct Heart(Vec<JoinHandle<()>>);

impl Drop for Heart {
    fn drop(&mut self) {
        for task in &self.0 {
            task.abort();
        }
    }
}

/// Beats until dropped. With SQLite there is nothing to show: the process owns the database.
#[cfg(feature = "scale")]
pub(super) fn beating(store: &Store, queue: &Queue, claim: &Claim, beat: Duration) -> Heart {
    let mut tasks = Vec::new();
    if store.is_shared() && !fault("beat.none") {
        let (queue, claim) = (queue.clone(), claim.clone());
        tasks.push(tokio::spawn(async move {
            loop {
                tokio::time::sleep(beat).await;
                // A claim that is lost is noticed by its supervisor.
                if let Err(error) = queue.beat(&claim).await {
                    tracing::warn!(%error, "the beat of the claim cannot be written; the job goes on");
                }
            }
        }));
    }
    Heart(tasks)
}

/// With SQLite there is nothing to show: the process owns the database.
#[cfg(not(feature = "scale"))]
pub(super) fn beating(_: &Store, _: &Queue, _: &Claim, _: Duration) -> Heart {
    Heart(Vec::new())
}

/// Hands over new checkpoints at every beat until dropped.
pub(super) fn keeping_checkpoints(store: &Store, claim: &Claim, beat: Duration) -> Heart {
    if !store.blobs.are_remote() {
        return Heart(Vec::new());
    }
    let (store, job) = (store.clone(), claim.job.clone());
    Heart(vec![tokio::spawn(async move {
        let mut kept = BTreeSet::new();
        loop {
            tokio::time::sleep(beat).await;
            store.blobs.keep_checkpoints(&job, &mut kept).await;
        }
    })])
}
