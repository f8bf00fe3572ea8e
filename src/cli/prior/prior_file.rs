//! Reads the motion prior that a command works with.

use crate::cli::bad_input::BadInput;
use crate::motion_prior::MotionPrior;
use std::path::Path;

/// Reads a prior from a file; without a file the embedded prior.
pub(super) fn read_prior(file: Option<&Path>) -> anyhow::Result<MotionPrior> {
    let Some(file) = file else { return Ok(MotionPrior::embedded().clone()) };
    let bad = |reason: String| BadInput(format!("{}: {reason}", file.display()));
    let bytes = std::fs::read(file).map_err(|error| bad(error.to_string()))?;
    Ok(MotionPrior::from_bytes(&bytes).map_err(|error| bad(error.to_string()))?)
}
