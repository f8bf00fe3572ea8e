//! The error of unusable input.

/// Unusable input: exit code 2 and one line that names the input, the place and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct BadInput(pub(super) String);
