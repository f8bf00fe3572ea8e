//! The states' names, the legal transitions, and what the end of a claim leads to; no SQL.

use super::job::JobError;

/// The names of the states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)] // documented at `JobState`
pub enum Phase {
    Queued,
    Running,
    Canceling,
    Succeeded,
    Failed,
    Canceled,
    Dead,
}

use Phase as P;

impl Phase {
    /// Every state, in the order of a life.
    pub const ALL: [Phase; 7] = [P::Queued, P::Running, P::Canceling, P::Succeeded, P::Failed, P::Canceled, P::Dead];

    /// The spelling of the contract and of the database.
    pub fn name(self) -> &'static str {
        match self {
            P::Queued => "queued",
            P::Running => "running",
            P::Canceling => "canceling",
            P::Succeeded => "succeeded",
            P::Failed => "failed",
            P::Canceled => "canceled",
            P::Dead => "dead",
        }
    }

    /// Reads the spelling of the contract.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|phase| phase.name() == name)
    }

    /// Nothing leaves a final state.
    pub fn is_final(self) -> bool {
        matches!(self, P::Succeeded | P::Failed | P::Canceled | P::Dead)
    }

    /// The legal transitions, all of them.
    pub fn may_become(self, next: Phase) -> bool {
        match self {
            P::Queued => matches!(next, P::Running | P::Canceled),
            P::Running => matches!(next, P::Queued | P::Canceling | P::Succeeded | P::Failed | P::Dead),
            P::Canceling => matches!(next, P::Canceled),
            P::Succeeded | P::Failed | P::Canceled | P::Dead => false,
        }
    }
}

/// How a claim ended, as its worker saw it; `T` is what was published.
#[derive(Debug)]
pub enum Ending<T> {
    /// The result lies published in its folder.
    Succeeded(T),
    /// The child gave a typed cause.
    Failed(JobError),
    /// The child ended without a word, or had to be killed.
    ChildDied(String),
    /// The service stops, or could not start a child: not the job's fault.
    Released,
}

/// What becomes of a job in `asked` (running or canceling) whose claim ended, with its `deaths` before that.
pub fn next_phase<T>(asked: Phase, ending: &Ending<T>, deaths: i64, max_deaths: u32) -> Phase {
    match (asked, ending) {
        (P::Canceling, _) => P::Canceled, // a promised cancel outweighs a result that came too late
        (_, Ending::Succeeded(_)) => P::Succeeded,
        (_, Ending::Failed(_)) => P::Failed,
        (_, Ending::ChildDied(_)) if deaths + 1 >= i64::from(max_deaths) => P::Dead,
        (_, Ending::ChildDied(_) | Ending::Released) => P::Queued,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_reads_its_own_name_and_final_states_lead_nowhere() {
        for phase in Phase::ALL {
            assert_eq!(Phase::parse(phase.name()), Some(phase));
            assert_eq!(phase.is_final(), Phase::ALL.into_iter().all(|next| !phase.may_become(next)));
        }
    }

    #[test]
    fn every_ending_leads_to_a_legal_state() {
        let endings = || {
            [
                Ending::Succeeded(()),
                Ending::Failed(JobError::default()),
                Ending::ChildDied(String::new()),
                Ending::Released,
            ]
        };
        for asked in [P::Running, P::Canceling] {
            for deaths in 0..3 {
                for ending in endings() {
                    assert!(asked.may_become(next_phase(asked, &ending, deaths, 3)), "{asked:?} {ending:?}");
                }
            }
        }
    }

    #[test]
    fn the_third_death_of_the_own_child_is_the_end_and_a_stop_of_the_service_never_is() {
        let died = Ending::<()>::ChildDied("signal 9".to_owned());
        let phases: Vec<_> = (0..3).map(|deaths| next_phase(P::Running, &died, deaths, 3)).collect();
        assert_eq!(phases, [P::Queued, P::Queued, P::Dead]);
        assert_eq!(next_phase(P::Running, &Ending::<()>::Released, 2, 3), P::Queued);
    }
}
