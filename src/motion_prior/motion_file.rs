//! Reading motion capture in the AMASS layout, turned to y up.
//!
//! `poses` (frames, 72 | 156 | 165) axis-angle in SMPL's order, `trans` (frames, 3) m, `mocap_framerate` or
//! `mocap_frame_rate`, optional `rest_joints` (24, 3). Of the wide layouts only the 22 body joints are read. A
//! constant offset of `trans` from the pelvis has no effect: every person is placed anew.

use super::chart::LocalRotations;
use crate::body::skeleton::N_JOINTS;
use crate::formats::npy::{Array, NpyError};
use crate::formats::npz::NpzReader;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

/// Why a motion file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum MotionProblem {
    /// The file cannot be opened or read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file is not a zip archive, or the array is missing.
    #[error("array {array}: {source}")]
    Archive {
        /// Name of the array.
        array: &'static str,
        /// Error of the zip reader.
        source: zip::result::ZipError,
    },
    /// An array has the wrong shape.
    #[error("array {array}: shape {expected} expected, found {found:?}")]
    Shape {
        /// Name of the array.
        array: &'static str,
        /// Expected shape.
        expected: &'static str,
        /// Shape in the file.
        found: Vec<usize>,
    },
    /// An array contains values that are not finite numbers.
    #[error("array {array}: finite numbers expected")]
    Values {
        /// Name of the array.
        array: &'static str,
    },
    /// The frame rate is missing or not positive.
    #[error("mocap_framerate: a positive number expected")]
    FrameRate,
}

/// Most numbers of an array, checked before it is read: 10 hours at 120 Hz.
const MAX_NUMBERS: usize = 165 * 120 * 36_000;

/// The motion of one file, y up.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionTake {
    /// Joints of the file's own skeleton in the zero pose, m, if the file has them.
    pub rest_joints: Option<[Vector3<f64>; N_JOINTS]>,
    /// Poses by frame, at least one.
    pub poses: Vec<MotionPose>,
    /// Frame rate of the file, Hz.
    pub fps: f64,
}

/// The pose of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionPose {
    /// `parent_from_joint`; entry 0 is `world_from_pelvis`.
    pub rotations: LocalRotations,
    /// Position of the pelvis joint in the world, m, up to a constant offset.
    pub pelvis: Vector3<f64>,
}

/// Reads a motion file.
///
/// # Errors
/// [`MotionProblem`] names the array and what was expected.
pub fn read_take(path: &Path) -> Result<MotionTake, MotionProblem> {
    let mut archive = NpzReader::new(BufReader::new(File::open(path)?)).map_err(|error| problem("poses", error))?;
    let poses = required(&mut archive, "poses")?;
    let trans = required(&mut archive, "trans")?;
    let (n_frames, width) = match poses.shape[..] {
        [n, width @ (72 | 156 | 165)] if n > 0 => (n, width),
        _ => {
            return Err(MotionProblem::Shape {
                array: "poses",
                expected: "(frames, 72 | 156 | 165)",
                found: poses.shape,
            });
        }
    };
    if trans.shape != [n_frames, 3] {
        return Err(MotionProblem::Shape { array: "trans", expected: "(frames of poses, 3)", found: trans.shape });
    }
    let rate = match array(&mut archive, "mocap_framerate")? {
        None => array(&mut archive, "mocap_frame_rate")?,
        found => found,
    };
    let fps = rate.and_then(|a| a.values.first().copied()).filter(|f| *f > 0.0).ok_or(MotionProblem::FrameRate)?;
    let rest_joints = match array(&mut archive, "rest_joints")? {
        None => None,
        Some(rest) if rest.shape == [N_JOINTS, 3] => {
            Some(std::array::from_fn(|j| Vector3::from_column_slice(&rest.values[3 * j..3 * j + 3])))
        }
        Some(rest) => {
            return Err(MotionProblem::Shape { array: "rest_joints", expected: "(24, 3)", found: rest.shape });
        }
    };
    // In the wide layouts fingers, or jaw and eyes, follow the 22 body joints.
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

fn required(archive: &mut NpzReader<BufReader<File>>, name: &'static str) -> Result<Array, MotionProblem> {
    let missing = MotionProblem::Archive { array: name, source: zip::result::ZipError::FileNotFound };
    array(archive, name)?.ok_or(missing)
}

/// An array of finite numbers; `None` if the archive does not contain the name.
fn array(archive: &mut NpzReader<BufReader<File>>, name: &'static str) -> Result<Option<Array>, MotionProblem> {
    let array = archive.array(name, MAX_NUMBERS).map_err(|error| problem(name, error))?;
    if array.as_ref().is_some_and(|array| !array.values.iter().all(|value| value.is_finite())) {
        return Err(MotionProblem::Values { array: name });
    }
    Ok(array)
}

fn problem(array: &'static str, error: NpyError) -> MotionProblem {
    match error {
        NpyError::Io(error) | NpyError::Header(error) => MotionProblem::Io(error),
        NpyError::Archive(source) => MotionProblem::Archive { array, source },
        NpyError::NotNumbers { .. } | NpyError::Length { .. } => MotionProblem::Values { array },
        NpyError::TooLarge { shape, .. } => {
            MotionProblem::Shape { array, expected: "at most 10 hours at 120 Hz", found: shape }
        }
    }
}

/// Turns a motion to y up. AMASS has z up, others y: the axis that the pelvis's own up axis is closest to on average.
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
