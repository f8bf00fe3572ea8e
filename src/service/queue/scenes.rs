//! Provisional scenes: cameras and people of the jobs that this process runs, as they are known so far.
//!
//! Why not in the store: a scene is worth nothing after the job, changes three times in it, and is found anew by the next
//! attempt. Where several processes share the jobs, the one that runs a job has its scene, as it has the log lines.

use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Cameras and people after one stage of a job.
#[derive(Debug)]
pub struct Scene {
    /// Name of the stage.
    pub stage: String,
    /// A JSON document.
    pub document: String,
    /// SHA-256 of the document, hex.
    pub sha256: String,
}

/// The newest scene of each running job.
#[derive(Debug, Default)]
pub(super) struct Scenes {
    by_job: Mutex<BTreeMap<String, Arc<Scene>>>,
}

impl Scenes {
    /// Replaces the scene of a job.
    pub(super) fn put(&self, job: &str, stage: String, document: String) {
        let sha256 = hex::encode(Sha256::digest(&document));
        self.by_job().insert(job.to_owned(), Arc::new(Scene { stage, document, sha256 }));
    }

    /// The newest scene of a job.
    pub(super) fn get(&self, job: &str) -> Option<Arc<Scene>> {
        self.by_job().get(job).cloned()
    }

    /// Removes the scene of a job.
    pub(super) fn remove(&self, job: &str) {
        self.by_job().remove(job);
    }

    fn by_job(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Scene>>> {
        self.by_job.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
