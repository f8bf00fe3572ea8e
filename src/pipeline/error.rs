//! Why a session cannot be solved.

use crate::progress::Canceled;

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
        /// What is missing and what to do about it.
        reason: String,
    },
}
