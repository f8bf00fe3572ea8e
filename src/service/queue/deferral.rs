//! Jobs that were put back after a fault of the machine, such as a full disk. Each waits before its next try, longer every
//! time, while other jobs run.
//!
//! The times are monotonic and kept in memory: a changed clock has no effect, and a restart tries every job at once.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

const FIRST_WAIT: Duration = Duration::from_secs(5);
const LONGEST_WAIT: Duration = Duration::from_secs(300);

/// Tries after which a job ends with the fault: with the waits above about eight hours.
const MAX_TRIES: u32 = 100;

/// While so many jobs wait, the machine can run no job, and none is claimed.
const MAX_WAITING: usize = 64;

/// The waiting jobs by id.
#[derive(Debug, Default)]
pub(super) struct Deferrals {
    jobs: BTreeMap<String, Deferral>,
}

#[derive(Debug)]
struct Deferral {
    tries: u32,
    due: Instant,
}

impl Deferrals {
    /// Time until the next try of a job whose claim has just met a fault; `None` after too many tries.
    pub(super) fn next_wait(&self, job: &str) -> Option<Duration> {
        let tries = self.jobs.get(job).map_or(0, |deferral| deferral.tries);
        let wait = FIRST_WAIT.saturating_mul(1 << tries.min(10));
        (tries < MAX_TRIES).then(|| wait.min(LONGEST_WAIT))
    }

    /// Lets the job wait.
    pub(super) fn defer(&mut self, job: &str, now: Instant, wait: Duration) {
        let deferral = self.jobs.entry(job.to_owned()).or_insert(Deferral { tries: 0, due: now });
        deferral.tries += 1;
        deferral.due = now + wait;
    }

    /// Forgets a job that has ended or was deleted.
    pub(super) fn forget(&mut self, job: &str) {
        self.jobs.remove(job);
    }

    /// Ids of the jobs that must not be claimed yet; `None` if no job at all should be.
    pub(super) fn waiting(&self, now: Instant) -> Option<Vec<&str>> {
        let waiting = self.jobs.iter().filter(|(_, deferral)| deferral.due > now);
        let waiting: Vec<&str> = waiting.map(|(job, _)| job.as_str()).collect();
        (waiting.len() < MAX_WAITING).then_some(waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_longer_with_every_try_and_gives_up() {
        let mut deferrals = Deferrals::default();
        let now = Instant::now();
        let mut waits = Vec::new();
        while let Some(wait) = deferrals.next_wait("a") {
            deferrals.defer("a", now, wait);
            assert_eq!(deferrals.waiting(now), Some(vec!["a"]));
            assert_eq!(deferrals.waiting(now + wait), Some(vec![]));
            waits.push(wait.as_secs());
        }
        assert_eq!(waits[..8], [5, 10, 20, 40, 80, 160, 300, 300]);
        let hours = waits.iter().sum::<u64>() / 3600;
        assert_eq!((waits.len(), hours), (100, 7));
        deferrals.forget("a");
        assert_eq!(deferrals.next_wait("a"), Some(FIRST_WAIT));
    }

    #[test]
    fn many_waiting_jobs_stop_all_claims() {
        let mut deferrals = Deferrals::default();
        let now = Instant::now();
        for n in 0..MAX_WAITING {
            assert!(deferrals.waiting(now).is_some());
            deferrals.defer(&n.to_string(), now, FIRST_WAIT);
        }
        assert!(deferrals.waiting(now).is_none());
        assert_eq!(deferrals.waiting(now + FIRST_WAIT), Some(vec![]));
    }
}
