//! Outcome of a claim and the job state that follows from it; no SQL.

use super::job::JobError;
use super::phase::Phase;

/// Outcome of a claim as its worker observed it; `T` is the published result.
#[derive(Debug)]
pub enum ClaimOutcome<T> {
    /// The result is published in its folder.
    Succeeded(T),
    /// The child process reported a typed error.
    Failed(JobError),
    /// The child process ended without a report, or had to be killed; the text says how.
    Crashed(String),
    /// The service stops or could not start a child process; this does not count against the job.
    Released,
}

/// Returns the next state of a job in `current` (running or canceling) whose claim ended; `crashes` is its crash count before.
pub fn next_phase<T>(current: Phase, outcome: &ClaimOutcome<T>, crashes: i64, max_crashes: u32) -> Phase {
    match (current, outcome) {
        (Phase::Canceling, _) => Phase::Canceled, // an accepted cancel takes precedence over a result that came too late
        (_, ClaimOutcome::Succeeded(_)) => Phase::Succeeded,
        (_, ClaimOutcome::Failed(_)) => Phase::Failed,
        (_, ClaimOutcome::Crashed(_)) if crashes + 1 >= i64::from(max_crashes) => Phase::Dead,
        (_, ClaimOutcome::Crashed(_) | ClaimOutcome::Released) => Phase::Queued,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_canceling_job_ends_canceled_whatever_the_outcome() {
        let outcomes = [
            ClaimOutcome::Succeeded(()),
            ClaimOutcome::Failed(JobError::default()),
            ClaimOutcome::Crashed(String::new()),
            ClaimOutcome::Released,
        ];
        for outcome in outcomes {
            assert_eq!(next_phase(Phase::Canceling, &outcome, 2, 3), Phase::Canceled, "{outcome:?}");
        }
    }

    #[test]
    fn third_crash_is_final_and_a_service_stop_never_is() {
        let crashed = ClaimOutcome::<()>::Crashed("signal 9".to_owned());
        let phases: Vec<_> = (0..3).map(|crashes| next_phase(Phase::Running, &crashed, crashes, 3)).collect();
        assert_eq!(phases, [Phase::Queued, Phase::Queued, Phase::Dead]);
        assert_eq!(next_phase(Phase::Running, &ClaimOutcome::<()>::Released, 2, 3), Phase::Queued);
    }
}
