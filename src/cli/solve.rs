//! From a session on disk to a result folder: the work shared by `reconstruct` and `run-job`.

use crate::body::BodyModel;
use crate::export::{self, ResultContext};
use crate::pipeline::checkpoints::Checkpoints;
use crate::pipeline::config::Extrinsics;
use crate::pipeline::provisional::Watcher;
use crate::pipeline::{self, CameraFacts, Continuation, Options, PipelineError};
use crate::progress::Progress;
use crate::session::reconstruction::Quality;
use crate::session::upload::{self, UploadError, UploadLimits};
use std::io;
use std::path::{Path, PathBuf};

/// Reasons why no result was written.
#[derive(Debug, thiserror::Error)]
pub(super) enum SolveError {
    /// The session cannot be read.
    #[error(transparent)]
    Upload(#[from] UploadError),
    /// The session file differs from the one that the service accepted.
    #[cfg_attr(not(feature = "service"), allow(dead_code))] // only a stored session has an accepted digest
    #[error("the session file is missing or has changed since it was accepted; upload it again")]
    Changed,
    /// The pipeline failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The result cannot be written.
    #[error("cannot write the result: {0}")]
    Write(#[from] io::Error),
}

/// What a solve reads and writes.
pub(super) struct SolveFiles<'a> {
    /// The session.
    pub(super) session: &'a Path,
    /// Its expected digest.
    pub(super) sha256: Option<&'a str>,
    /// Folder of finished stages, from which interrupted work resumes.
    pub(super) checkpoints: Option<&'a Path>,
    /// Folders of results from which a solve with corrections continues: the first that fits.
    pub(super) earlier: &'a [PathBuf],
    /// Folder of the new result.
    pub(super) out: &'a Path,
}

/// Reads the session, solves it and writes the result.
pub(super) fn solve(
    files: &SolveFiles,
    options: &Options,
    body: &BodyModel,
    watcher: &Watcher,
    progress: &Progress,
) -> Result<Quality, SolveError> {
    let SolveFiles { session, sha256, checkpoints, earlier, out } = *files;
    keep_freed_memory();
    let mut loaded = upload::read_path(session, &UploadLimits::default())?;
    for warning in loaded.warnings.iter().cloned().chain(ignored_poses(options, &CameraFacts::of(&loaded.session))) {
        tracing::warn!("{warning}");
    }
    if sha256.is_some_and(|sha256| sha256 != loaded.sha256) {
        return Err(SolveError::Changed);
    }
    loaded.session.fps = options.fps.unwrap_or(loaded.session.fps); // the result's files state the rate that was used
    let checkpoints = match checkpoints {
        Some(folder) => Checkpoints::in_folder(folder, &loaded.sha256, options, body),
        None => Checkpoints::none(),
    };
    let continuation = match options.corrections.is_empty() {
        true => None,
        false => earlier.iter().find_map(|result| read_continuation(result, &loaded.sha256, options)),
    };
    if let (None, [first, ..], false) = (&continuation, earlier, options.corrections.is_empty()) {
        let result = first.display();
        tracing::warn!("{result}: no result of this session with these options; it is solved from the start");
    }
    let solved =
        pipeline::solve(&loaded.session, options, body, &checkpoints, continuation.as_ref(), watcher, progress)?;
    let pipeline::SolvedSession { reconstruction, continuation } = solved;
    let continuation = || continuation.to_text(&loaded.sha256, options).map_err(io::Error::from);
    let context = ResultContext {
        input_sha256: &loaded.sha256,
        options: serde_json::to_value(options).map_err(io::Error::from)?,
        solver_version: env!("CARGO_PKG_VERSION"),
        exports: &options.exports,
        continuation: Some(&continuation),
    };
    let session = pipeline::as_solved(&loaded.session, options, &reconstruction);
    export::write_result(out, &session, &context, &reconstruction)?;
    Ok(reconstruction.report.quality)
}

/// Lets the allocator keep what is freed, for the next iteration of a solver.
///
/// glibc returns the end of its heap to the system as soon as 128 kB of it are free, and every page costs a fault when it is needed
/// again. Freeing a block of its own once raises that to twice the block's size (mallopt(3), `M_MMAP_THRESHOLD`); other
/// allocators take it as any other block, which is never written to.
fn keep_freed_memory() {
    const BLOCK: usize = 31 << 20; // blocks from 32 MiB on change nothing
    drop(std::hint::black_box(vec![0u8; BLOCK]));
}

/// What a result says of the cameras and people without corrections, if it is of this session and these options.
pub(super) fn read_continuation(result: &Path, sha256: &str, options: &Options) -> Option<Continuation> {
    let text = std::fs::read_to_string(result.join(export::CONTINUATION)).ok()?;
    Continuation::from_text(&text, sha256, options)
}

/// A warning where the session gives camera poses that the options do not use.
pub(super) fn ignored_poses(options: &Options, cameras: &[CameraFacts]) -> Option<String> {
    let n = cameras.iter().filter(|camera| camera.has_extrinsics).count();
    let remedy = match (n == cameras.len(), cameras.len()) {
        (false, _) => "give those of every camera and use \"fixed\" or \"refine\"",
        (true, 1) => "use \"fixed\"",
        (true, _) => "use \"fixed\" or \"refine\"",
    };
    (n > 0 && options.extrinsics == Extrinsics::Estimate).then(|| {
        format!(
            "the session gives R and t of {n} of {} cameras, which `extrinsics: estimate` ignores; {remedy} to keep them and their \
             world",
            cameras.len()
        )
    })
}

/// Sets the number of solver threads of this process; 0 uses all cores.
pub(super) fn use_threads(threads: usize) {
    // Fails only if a pool exists already, which does not happen in any command.
    if let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        tracing::warn!(%error, "the number of threads was not changed");
    }
}
