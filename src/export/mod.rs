//! Writers of the result folder, one file per format: the output of `wandless reconstruct --out` and the artifacts of a job.
//!
//! World: right-handed, metres; `x_camera = R x_world + t` with OpenCV's camera axes. Frames have the session's frame
//! numbers. The same reconstruction gives the same bytes: files contain no wall-clock times and no map of arbitrary order.
//!
//! The JSON files are written from the [`Reconstruction`], the formats of other programs from a [`Take`] of it, which can
//! also be read back from the JSON files ([`read_take`]). The manifest lists what a format cannot represent.

mod additions;
mod blender;
mod body_mesh;
mod buffers;
mod bvh;
mod c3d;
mod calibration_toml;
mod cameras;
mod chan;
mod colmap;
mod context;
mod detections_bin;
mod easymocap;
mod fbx;
mod files;
mod film;
mod formats;
mod glb;
mod identities;
mod inverse_kinematics;
mod joint_angles;
mod joint_names;
mod joints;
mod losses;
mod manifest;
mod markers;
mod motion_bin;
mod names;
mod opencv_yaml;
mod people;
mod read;
mod rig;
mod rotation_forms;
mod skin;
mod smpl_npz;
mod take;
mod trc;
mod usd;

#[cfg(test)]
mod sample_motion;
#[cfg(test)]
mod tests;

pub use additions::{AdditionError, missing_formats, write_additions};
pub use body_mesh::{BodyMesh, default_body_mesh};
pub use context::ResultContext;
pub use formats::{Representation, RepresentationData, name};
pub use read::{ReadError, read_take};
pub use take::{KeypointFrames, OtherBody, Take, TakeCamera};

use crate::session::reconstruction::ExportFormat;
use crate::session::{Reconstruction, Session};
use files::{Draft, ResultFiles};
use manifest::Written;
use rayon::prelude::*;
use std::io;
use std::path::Path;

/// The file from which a solve with corrections continues.
pub const CONTINUATION: &str = "stages/continuation.txt";

/// Media type of files that only the viewer reads.
const OCTETS: &str = "application/octet-stream";

/// Writes all files of a result into `dir`, which is created where it is missing; the manifest is written last. `session`: as the
/// result has it, which is what [`as_solved`](crate::pipeline::as_solved) gives for the session of the solve.
///
/// Numbers are finite or null. Metres and radians are rounded to 1e-6, except for camera poses. Files of an earlier result
/// that this one does not contain are not removed and not listed in the manifest.
///
/// # Errors
/// The error of the file system.
pub fn write_result(
    dir: &Path,
    session: &Session,
    context: &ResultContext<'_>,
    reconstruction: &Reconstruction,
) -> io::Result<()> {
    let mut files = ResultFiles::create(dir)?;
    let mut drafts = vec![
        Draft::json("cameras.json", || cameras::cameras(session, reconstruction)),
        Draft::json("people.json", || people::people(session, reconstruction)),
        Draft::json("poses3d.json", || joints::body_joints(session, reconstruction)),
        Draft::json("keypoints3d.json", || joints::keypoints(session, reconstruction)),
        Draft::json("identities.json", || identities::Identities { session, reconstruction }),
        Draft::json("report.json", || &reconstruction.report),
        Draft::bytes("stages/motion.bin", OCTETS, || motion_bin::motion_bin(session, reconstruction)),
        Draft::bytes("stages/detections.bin", OCTETS, || detections_bin::detections_bin(session, reconstruction)),
    ];
    if let Some(continuation) = context.continuation {
        drafts.push(Draft::bytes(CONTINUATION, "text/plain", || Ok(continuation()?.into_bytes())));
    }
    files.drafts(&drafts)?;
    let take = take::take_of(session, reconstruction);
    let representations = write_all(&mut files, &take, context.exports)?;
    let written = Written { representations, files: files.written().to_vec() };
    files.json("manifest.json", &manifest::manifest(session, context, reconstruction, &take, written))
}

/// Writes a take in further formats into `dir`, which is created where it is missing, and describes each format with its
/// losses.
///
/// The bytes are the same as if the formats had been written with the result. Files of the same name are replaced.
///
/// # Errors
/// The error of the file system.
pub fn write_formats(dir: &Path, take: &Take, formats: &[ExportFormat]) -> io::Result<Vec<Representation>> {
    write_all(&mut ResultFiles::create(dir)?, take, formats)
}

/// Writes each format once, even where it is requested twice.
fn write_all(files: &mut ResultFiles, take: &Take, formats: &[ExportFormat]) -> io::Result<Vec<Representation>> {
    let is_new = |i: usize| !formats[..i].contains(&formats[i]);
    let formats: Vec<ExportFormat> = (0..formats.len()).filter(|&i| is_new(i)).map(|i| formats[i]).collect();
    let write = |format: &ExportFormat| {
        let mut own = files.beside();
        Ok((formats::write(*format, &mut own, take)?, own))
    };
    let of_formats: Vec<(Representation, ResultFiles)> = formats.par_iter().map(write).collect::<io::Result<_>>()?;
    let (representations, lists): (Vec<_>, Vec<_>) = of_formats.into_iter().unzip();
    lists.into_iter().for_each(|list| files.append(list));
    Ok(representations)
}
