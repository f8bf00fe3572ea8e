//! Motion capture in the AMASS layout: what a file holds, turned upright.
//!
//! `poses` (frames, 72 | 156 | 165) axis-angle in SMPL's order, `trans` (frames, 3) m, `mocap_framerate` or
//! `mocap_frame_rate`, optional `rest_joints` (24, 3). Of the wide layouts only the 22 body joints are read. Constant
//! offsets of `trans` from the pelvis do not matter: every person is placed anew.

use super::chart::LocalRotations;
use crate::body::loader::npy_head::with_flat_head;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;
use zip::ZipArchive;

/// What is wrong with a motion file.
#[derive(Debug, thiserror::Error)]
pub enum MotionProblem {
    /// It cannot be opened or read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It is no zip archive, or holds no such array.
    #[error("array {array}: {source}")]
    Archive {
        /// Name of the array.
        array: &'static str,
        /// The archive's own words.
        source: zip::result::ZipError,
    },
    /// An array has the wrong shape.
    #[error("array {array}: shape {expected} expected, found {found:?}")]
    Shape {
        /// Name of the array.
        array: &'static str,
        /// What fits.
        expected: &'static str,
        /// What is there.
        found: Vec<u64>,
    },
    /// An array holds something else than real numbers.
    #[error("array {array}: finite numbers expected")]
    Values {
        /// Name of the array.
        array: &'static str,
    },
    /// There is no frame rate.
    #[error("mocap_framerate: a positive number expected")]
    FrameRate,
}

/// Arrays larger than this are refused before they are read: 10 hours at 120 Hz.
const MAX_NUMBERS: u64 = 165 * 120 * 36_000;

/// A file as it is, y up.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionTake {
    /// Joints of the file's own skeleton in the zero pose, m, where it has one.
    pub rest_joints: Option<[Vector3<f64>; N_JOINTS]>,
    /// At least one pose.
    pub poses: Vec<MotionPose>,
    /// The file's own rate, Hz.
    pub fps: f64,
}

/// One frame of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionPose {
    /// `parent_from_joint`; entry 0 is `world_from_pelvis`.
    pub rotations: LocalRotations,
    /// The pelvis joint in the world, m, up to a constant offset.
    pub pelvis: Vector3<f64>,
}

struct Array {
    shape: Vec<u64>,
    values: Vec<f64>,
}

/// Reads a file.
///
/// # Errors
/// [`MotionProblem`] names the array and what was expected of it.
pub fn read_take(path: &Path) -> Result<MotionTake, MotionProblem> {
    let mut archive = ZipArchive::new(BufReader::new(File::open(path)?))
        .map_err(|source| MotionProblem::Archive { array: "poses", source })?;
    let poses = required(&mut archive, "poses")?;
    let trans = required(&mut archive, "trans")?;
    let (n_frames, width) = match poses.shape[..] {
        [n, width @ (72 | 156 | 165)] if n > 0 => (n as usize, width as usize),
        _ => {
            return Err(MotionProblem::Shape {
                array: "poses",
                expected: "(frames, 72 | 156 | 165)",
                found: poses.shape,
            });
        }
    };
    if trans.shape != [n_frames as u64, 3] {
        return Err(MotionProblem::Shape { array: "trans", expected: "(frames of poses, 3)", found: trans.shape });
    }
    let rate = match array(&mut archive, "mocap_framerate")? {
        None => array(&mut archive, "mocap_frame_rate")?,
        found => found,
    };
    let fps = rate.and_then(|a| a.values.first().copied()).filter(|f| *f > 0.0).ok_or(MotionProblem::FrameRate)?;
    let rest_joints = match array(&mut archive, "rest_joints")? {
        None => None,
        Some(rest) if rest.shape == [N_JOINTS as u64, 3] => {
            Some(std::array::from_fn(|j| Vector3::from_column_slice(&rest.values[3 * j..3 * j + 3])))
        }
        Some(rest) => {
            return Err(MotionProblem::Shape { array: "rest_joints", expected: "(24, 3)", found: rest.shape });
        }
    };
    // In the wide layouts fingers or jaw and eyes follow the 22 body joints.
    let n_read = if width == 72 { N_JOINTS } else { 22 };
    let pose = |frame: usize| {
        let row = &poses.values[frame * width..(frame + 1) * width];
        let turn = |j: usize| rotation::exp(&Vector3::from_column_slice(&row[3 * j..3 * j + 3]));
        MotionPose {
            rotations: std::array::from_fn(|j| if j < n_read { turn(j) } else { Matrix3::identity() }),
            pelvis: Vector3::from_column_slice(&trans.values[3 * frame..3 * frame + 3]),
        }
    };
    let mut poses: Vec<MotionPose> = (0..n_frames).map(pose).collect();
    turn_y_up(&mut poses);
    Ok(MotionTake { rest_joints, poses, fps })
}

fn required(archive: &mut ZipArchive<BufReader<File>>, name: &'static str) -> Result<Array, MotionProblem> {
    let missing = MotionProblem::Archive { array: name, source: zip::result::ZipError::FileNotFound };
    array(archive, name)?.ok_or(missing)
}

/// An array of real numbers in C order; `None` where the archive has none of the name.
fn array(archive: &mut ZipArchive<BufReader<File>>, name: &'static str) -> Result<Option<Array>, MotionProblem> {
    let member = match archive.by_name(&npyz::npz::file_name_from_array_name(name)) {
        Err(zip::result::ZipError::FileNotFound) => return Ok(None),
        member => member.map_err(|source| MotionProblem::Archive { array: name, source })?,
    };
    let file = npyz::NpyFile::new(with_flat_head(member)?)?;
    let shape = file.shape().to_vec();
    let size = shape.iter().try_fold(1_u64, |size, n| size.checked_mul(*n)).filter(|size| *size <= MAX_NUMBERS);
    if size.is_none() || file.order() != npyz::Order::C {
        return Err(MotionProblem::Shape { array: name, expected: "at most 10 hours in C order", found: shape });
    }
    let values = real_numbers(file).ok_or(MotionProblem::Values { array: name })?;
    if !values.iter().all(|value| value.is_finite()) {
        return Err(MotionProblem::Values { array: name });
    }
    Ok(Some(Array { shape, values }))
}

/// Doubles, floats or integers as doubles; `None` for anything else or a file that ends early.
fn real_numbers<R: io::Read>(file: npyz::NpyFile<R>) -> Option<Vec<f64>> {
    let file = match file.try_data::<f64>() {
        Ok(data) => return data.collect::<io::Result<Vec<f64>>>().ok(),
        Err(file) => file,
    };
    let file = match file.try_data::<f32>() {
        Ok(data) => return data.map(|value| value.map(f64::from)).collect::<io::Result<Vec<f64>>>().ok(),
        Err(file) => file,
    };
    let data = file.try_data::<i64>().ok()?;
    data.map(|value| value.map(|v| v as f64)).collect::<io::Result<Vec<f64>>>().ok()
}

/// AMASS stands on z, others on y: whichever the pelvis' own up axis mostly points along is up.
fn turn_y_up(poses: &mut [MotionPose]) {
    let up: Vector3<f64> = poses.iter().map(|pose| pose.rotations[0].column(1).into_owned()).sum();
    if up.z.abs() <= up.y.abs() {
        return;
    }
    let y_up_from_z_up = rotation::exp(&Vector3::new(-std::f64::consts::FRAC_PI_2, 0.0, 0.0));
    for pose in poses {
        pose.rotations[0] = y_up_from_z_up * pose.rotations[0];
        pose.pelvis = y_up_from_z_up * pose.pelvis;
    }
}
