//! Writing motions in the AMASS layout for other tools.

use super::motion_file::MotionTake;
use crate::formats::npz::{CompressionMethod, NpzWriter};
use crate::geometry::rotation;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

/// Writes `poses` (frames, 72) axis-angle, `trans` (frames, 3), `betas` of zeros, `mocap_framerate` and, if the take
/// has them, `rest_joints`. The same take gives the same bytes.
///
/// # Errors
/// What the file system reports.
pub fn write_take(path: &Path, take: &MotionTake) -> io::Result<()> {
    let mut npz = NpzWriter::new(File::create(path)?, CompressionMethod::Deflated);
    let n = take.poses.len();
    let angles =
        take.poses.iter().flat_map(|pose| pose.rotations.iter().flat_map(|r| <[f64; 3]>::from(rotation::log(r))));
    npz.array("poses", &[n, 72], angles)?;
    npz.array("trans", &[n, 3], take.poses.iter().flat_map(|pose| <[f64; 3]>::from(pose.pelvis)))?;
    npz.array("betas", &[10], [0.0; 10])?;
    npz.array("mocap_framerate", &[], [take.fps])?;
    if let Some(rest) = &take.rest_joints {
        npz.array("rest_joints", &[24, 3], rest.iter().flat_map(|joint| <[f64; 3]>::from(*joint)))?;
    }
    npz.finish()?.flush()
}
