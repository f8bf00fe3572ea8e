//! From a session on disk to a result folder: what `reconstruct` and a job's child have in common.

use crate::body::BodyModel;
use crate::export::{self, ResultContext};
use crate::pipeline::checkpoints::Checkpoints;
use crate::pipeline::{self, Options, PipelineError};
use crate::progress::Progress;
use crate::session::reconstruction::Quality;
use crate::session::upload::{self, UploadError, UploadLimits};
use std::io;
use std::path::Path;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub(super) enum SolveError {
    /// The session cannot be read.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// The bytes are not the ones that were accepted.
    #[cfg_attr(not(feature = "service"), allow(dead_code))] // only a stored session has an accepted digest
    #[error("the session's bytes have changed since they were accepted; upload them again")]
    Changed,
    /// The pipeline gave up.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The result cannot be written.
    #[error("the result cannot be written: {0}")]
    Write(#[from] io::Error),
}

/// Reads the session, solves it and writes the result into `out`.
///
/// `sha256`: the digest that the session must have, where one is known. `checkpoints`: a folder for finished stages, where
/// interrupted work is to be resumed.
pub(super) fn solve(
    session: &Path,
    sha256: Option<&str>,
    options: &Options,
    body: &BodyModel,
    checkpoints: Option<&Path>,
    out: &Path,
    progress: &Progress,
) -> Result<Quality, SolveError> {
    let loaded = upload::read_path(session, &UploadLimits::default())?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
    }
    if sha256.is_some_and(|sha256| sha256 != loaded.sha256) {
        return Err(SolveError::Changed);
    }
    let checkpoints = match checkpoints {
        Some(folder) => Checkpoints::in_folder(folder, &loaded.sha256, options, body),
        None => Checkpoints::none(),
    };
    let reconstruction =
        pipeline::reconstruct_with_checkpoints(&loaded.session, options, body, &checkpoints, progress)?;
    let context = ResultContext {
        input_sha256: &loaded.sha256,
        options: serde_json::to_value(options).map_err(io::Error::from)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &options.exports,
    };
    export::write_result(out, &loaded.session, &context, &reconstruction)?;
    Ok(reconstruction.report.quality)
}

/// Sets the number of solver threads of this process; 0 takes all cores.
pub(super) fn use_threads(threads: usize) {
    // Fails only where a pool was made before, which no command does.
    if let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        tracing::warn!(%error, "the number of threads stays as it is");
    }
}
