//! Writing motions in the AMASS layout, so that other tools can show them.

use super::motion_file::MotionTake;
use crate::geometry::rotation;
use npyz::WriterBuilder;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{DateTime, ZipWriter};

/// Writes `poses` (frames, 72) axis-angle, `trans` (frames, 3), `betas` of zeros, `mocap_framerate` and, where the take
/// has them, `rest_joints`; without a clock, so that the same take gives the same bytes.
///
/// # Errors
/// What the file system says.
pub fn write_take(path: &Path, take: &MotionTake) -> io::Result<()> {
    let mut zip = ZipWriter::new(File::create(path)?);
    let n = take.poses.len() as u64;
    let angles =
        take.poses.iter().flat_map(|pose| pose.rotations.iter().flat_map(|r| <[f64; 3]>::from(rotation::log(r))));
    array(&mut zip, "poses", &[n, 72], angles)?;
    array(&mut zip, "trans", &[n, 3], take.poses.iter().flat_map(|pose| <[f64; 3]>::from(pose.pelvis)))?;
    array(&mut zip, "betas", &[10], [0.0; 10])?;
    array(&mut zip, "mocap_framerate", &[], [take.fps])?;
    if let Some(rest) = &take.rest_joints {
        array(&mut zip, "rest_joints", &[24, 3], rest.iter().flat_map(|joint| <[f64; 3]>::from(*joint)))?;
    }
    zip.finish()?.flush()
}

fn array(
    zip: &mut ZipWriter<File>,
    name: &str,
    shape: &[u64],
    values: impl IntoIterator<Item = f64>,
) -> io::Result<()> {
    let options = SimpleFileOptions::default().last_modified_time(DateTime::default());
    zip.start_file(npyz::npz::file_name_from_array_name(name), options)?;
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(zip).begin_nd()?;
    writer.extend(values)?;
    writer.finish()
}
