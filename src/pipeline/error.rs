//! Why a session cannot be solved.

use super::corrections::CorrectionError;
use crate::progress::Canceled;
use crate::session::Suspicion;

/// Why the pipeline ends without a result.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The caller asked the work to stop.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// An option does not fit the session.
    #[error("{option}: {reason}")]
    Option {
        /// JSON pointer into the options.
        option: &'static str,
        /// What is wrong and what to do about it.
        reason: String,
    },
    /// The session holds nothing that can be solved.
    #[error("{reason}")]
    Unsolvable {
        /// Machine-readable code.
        code: &'static str,
        /// What is missing and what to do about it; the probable mistakes in the files are part of it.
        reason: String,
        /// Probable mistakes in the files of the recording.
        suspicions: Vec<Suspicion>,
    },
}

impl From<CorrectionError> for PipelineError {
    fn from(error: CorrectionError) -> Self {
        Self::Option { option: "/corrections", reason: error.to_string() }
    }
}

impl PipelineError {
    /// The end of a solve of a recording in which these mistakes are probable.
    pub fn unsolvable(code: &'static str, reason: &str, suspicions: Vec<Suspicion>) -> Self {
        let named = suspicions.iter().map(|suspicion| format!("; probable mistake: {suspicion}"));
        let reason = format!("{reason}{}", named.collect::<String>());
        Self::Unsolvable { code, reason, suspicions }
    }
}
