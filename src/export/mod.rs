//! The result folder, one file a format: what `wandless reconstruct --out` and a job's artifacts hold.
//!
//! World: right-handed, metres; `x_camera = R x_world + t` with OpenCV's camera axes. Frames carry the session's own
//! numbers. The same reconstruction gives the same bytes: no clock, no map whose order could change.

mod buffers;
mod cameras;
mod detections_bin;
mod files;
mod identities;
mod joints;
mod manifest;
mod motion_bin;
mod people;
mod smpl_npz;

#[cfg(test)]
mod tests;

use crate::session::reconstruction::ExportFormat;
use crate::session::{Reconstruction, Session};
use files::ResultFiles;
use std::io;
use std::path::Path;

/// What a result says of its own making.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultContext<'a> {
    /// Digest of the input (`LoadedSession::sha256`).
    pub input_sha256: &'a str,
    /// The options as they were in force.
    pub options: serde_json::Value,
    /// Version of the program.
    pub solver_version: &'a str,
    /// Formats to write beside the JSON files.
    pub exports: &'a [ExportFormat],
}

/// Why a result cannot be written as asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ExportError {
    /// There is no writer of the format.
    #[error("the format {} cannot be written, smpl_npz can", name(*format))]
    Unsupported {
        /// The format asked for.
        format: ExportFormat,
    },
}

/// Whether the format can be written.
pub fn supported(format: ExportFormat) -> bool {
    matches!(format, ExportFormat::SmplNpz)
}

/// Whether every format can be written: to be asked before any work is done.
///
/// # Errors
/// [`ExportError::Unsupported`] for the first that cannot.
pub fn check(exports: &[ExportFormat]) -> Result<(), ExportError> {
    match exports.iter().find(|format| !supported(**format)) {
        Some(&format) => Err(ExportError::Unsupported { format }),
        None => Ok(()),
    }
}

/// The format's name in options and messages.
pub fn name(format: ExportFormat) -> String {
    match serde_json::to_value(format) {
        Ok(serde_json::Value::String(name)) => name,
        _ => format!("{format:?}"),
    }
}

/// Media type of files that only the viewer reads.
const OCTETS: &str = "application/octet-stream";

/// Writes every file of a result into `dir`, which is made where it is missing; the manifest comes last.
///
/// Numbers are finite or null. Metres and radians are rounded to 1e-6, the poses of cameras are not. Files of an earlier
/// result that this one does not have are left alone and not listed in the manifest.
///
/// # Errors
/// Whatever writing fails with; `Unsupported` around an [`ExportError`] where a format cannot be written.
pub fn write_result(
    dir: &Path,
    session: &Session,
    context: &ResultContext<'_>,
    reconstruction: &Reconstruction,
) -> io::Result<()> {
    check(context.exports).map_err(|e| io::Error::new(io::ErrorKind::Unsupported, e))?;
    let mut files = ResultFiles::create(dir)?;
    files.json("cameras.json", &cameras::cameras(session, reconstruction))?;
    files.json("people.json", &people::people(session, reconstruction))?;
    files.json("poses3d.json", &joints::body_joints(session, reconstruction))?;
    files.json("keypoints3d.json", &joints::keypoints(session, reconstruction))?;
    files.json("identities.json", &identities::Identities { session, reconstruction })?;
    files.json("report.json", &reconstruction.report)?;
    files.bytes("stages/motion.bin", OCTETS, &motion_bin::motion_bin(session, reconstruction)?)?;
    files.bytes("stages/detections.bin", OCTETS, &detections_bin::detections_bin(session, reconstruction)?)?;
    for format in context.exports {
        if *format == ExportFormat::SmplNpz {
            smpl_npz::write(&mut files, session, reconstruction)?;
        }
    }
    let manifest = manifest::manifest(session, context, reconstruction, files.written().to_vec());
    files.json("manifest.json", &manifest)
}
