//! The stages, in order; whoever reads this page knows what the program does.

pub mod body_fit;
pub mod config;

use crate::progress::{Canceled, Progress};
use crate::session::{Reconstruction, Session};
pub use config::Options;

/// Why a capture cannot be solved at all.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The caller asked to stop.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// An option asks for what the session does not hold.
    #[error("{option}: {reason}")]
    Option {
        /// JSON pointer into the options.
        option: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
    /// Nothing to solve.
    #[error("{reason}")]
    Unsolvable {
        /// Machine-readable code.
        code: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
}

/// Recovers cameras and people from a session.
///
/// # Errors
/// [`PipelineError`] when the work was canceled, or when nothing can be solved.
pub fn reconstruct(
    _session: &Session,
    _options: &Options,
    progress: &Progress,
) -> Result<Reconstruction, PipelineError> {
    progress.check()?;
    Err(PipelineError::Unsolvable { code: "not_solvable", reason: "the pipeline is being built".to_owned() })
}
