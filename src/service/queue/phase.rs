//! Names of the job states.

/// Name of a job state, without the data of [`JobState`](super::job::JobState).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, utoipa::ToSchema)]
#[schema(rename_all = "lowercase")]
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
    /// Every state, in the order of a job's life.
    pub const ALL: [Phase; 7] = [P::Queued, P::Running, P::Canceling, P::Succeeded, P::Failed, P::Canceled, P::Dead];

    /// Spelling in the HTTP API and in the database.
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

    /// Parses the spelling of the HTTP API.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|phase| phase.name() == name)
    }

    /// Whether the state is final: a job never leaves a final state.
    pub fn is_final(self) -> bool {
        matches!(self, P::Succeeded | P::Failed | P::Canceled | P::Dead)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_parses_its_own_name() {
        for phase in Phase::ALL {
            assert_eq!(Phase::parse(phase.name()), Some(phase));
        }
    }
}
