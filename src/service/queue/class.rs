//! Classes of jobs by the memory that they need, and what a worker must know to run a job. They matter where several workers share a
//! PostgreSQL server: a worker claims what it has memory for, and passes over what only a newer release can run.

use super::handle::Queue;
use super::job::JobError;
use super::outcome::ClaimOutcome;
use crate::service::failpoint::is_next_release;
use crate::service::store::sessions::SessionSummary;

/// The largest class.
pub const LARGEST: i64 = 3;

/// Memory that a worker of each class gives a job, bytes: 2, 8, 32 and 128 GiB. The setting `worker.class` chooses among them.
pub const MEMORY_BYTES: [u64; 4] = [2 << 30, 8 << 30, 32 << 30, 128 << 30];

/// Memory of a job beside its detections, bytes.
const BASE_BYTES: u64 = 256 << 20;

/// Memory of one person's detection in a view, bytes. 10,000 frames of 5 views and 4 people took 1,013 MiB at their peak, which is
/// 5 KB; sessions differ, and a job that does not fit is run again in the next class, so twice that is planned for.
const DETECTION_BYTES: u64 = 10_000;

/// The level of options that this release knows. It grows whenever an option, or a value of one, is added: a worker of a lower level
/// passes over the jobs of a newer API node, which it would end as `option_unknown`.
pub const OPTIONS_LEVEL: i64 = 2;

/// The class of a job on a session: the smallest with enough memory.
pub fn of_session(session: &SessionSummary) -> i64 {
    of_size(session.cameras as u64, session.frames as u64, session.people_max as u64)
}

/// The class of a job by cameras, frames, and the largest number of people in a frame of a view.
pub fn of_size(cameras: u64, frames: u64, people: u64) -> i64 {
    let detections = cameras.saturating_mul(frames).saturating_mul(people);
    let bytes = BASE_BYTES.saturating_add(detections.saturating_mul(DETECTION_BYTES));
    MEMORY_BYTES.iter().position(|limit| bytes <= *limit).map_or(LARGEST, |class| class as i64)
}

/// [`OPTIONS_LEVEL`] of this process; a check of upgrades lets a process be the next release.
pub(super) fn options_level() -> i64 {
    OPTIONS_LEVEL + i64::from(is_next_release())
}

impl Queue {
    /// The queue of a worker that has memory for jobs up to this class; without one it claims every job.
    pub fn with_class(mut self, class: Option<i64>) -> Self {
        self.class = class;
        self
    }

    /// The largest class that this process claims.
    #[cfg(feature = "scale")]
    pub(super) fn largest_class(&self) -> i64 {
        self.class.unwrap_or(LARGEST)
    }

    /// The class in which a job is run again that did not fit into the memory of this worker; `None` where it had the most.
    pub(super) fn class_after<T>(&self, outcome: &ClaimOutcome<T>) -> Option<i64> {
        let class = self.class.filter(|_| self.store.is_shared())?;
        let ran_out = matches!(outcome, ClaimOutcome::Failed(JobError { code, .. }) if code == OUT_OF_MEMORY);
        (ran_out && class < LARGEST).then_some(class + 1)
    }
}

/// Code of a job that needs more memory than its worker gives it.
pub const OUT_OF_MEMORY: &str = "out_of_memory";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Options;
    use sha2::{Digest, Sha256};

    #[test]
    fn classes_grow_with_the_session() {
        for (cameras, frames, people, class) in [
            (1, 1, 0, 0),
            (5, 1500, 4, 0),
            (5, 10_000, 3, 0),
            (5, 10_000, 4, 1),
            (8, 30_000, 6, 2),
            (16, 100_000, 10, 3),
            (u64::MAX, u64::MAX, 2, 3),
        ] {
            assert_eq!(of_size(cameras, frames, people), class, "{cameras} x {frames} x {people}");
        }
    }

    /// A job of a newer API node must not reach a worker that does not know its options.
    #[test]
    fn new_options_raise_the_level() {
        let table = crate::pipeline::option_table::OPTION_TABLE;
        let kinds: Vec<String> = table.iter().map(|row| format!("{} {:?}", row.name, row.kind)).collect();
        let known = serde_json::to_string(&Options::default()).unwrap();
        let digest = hex::encode(&Sha256::digest(format!("{kinds:?}{known}"))[..4]);
        assert_eq!(
            (OPTIONS_LEVEL, digest.as_str()),
            (2, "07c508a6"),
            "the options have changed: raise OPTIONS_LEVEL where a value was added, and note the digest here"
        );
    }
}
