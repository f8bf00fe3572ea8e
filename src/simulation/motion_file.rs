//! People from motion capture in the AMASS layout, resampled, turned upright and put on the floor.
//!
//! `poses` (frames, 72 | 156 | 165) axis-angle in SMPL's order, `trans` (frames, 3) m, `mocap_framerate` or
//! `mocap_frame_rate`, optional `rest_joints` (24, 3). Of the wide layouts only the 22 body joints are read. Constant
//! offsets of `trans` from the pelvis do not matter: every person is placed anew.

use super::SimulationError;
use super::config::SimulationConfig;
use super::random::{Purpose, stream};
use super::skeleton::{Person, Pose, Skeleton, joint};
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
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

/// One person a file, in the given order; the session is as long as the shortest of them, at most `config.frames`.
///
/// A longer take is read from a random start. Each person is shifted and turned on the floor so that people share the
/// space, 0.45 m apart where a place is found within 200 tries, within 2.2 m of the centre.
///
/// # Errors
/// [`SimulationError`] where there are too few files or one cannot be read.
pub fn people_from_files(paths: &[PathBuf], config: &SimulationConfig) -> Result<Vec<Person>, SimulationError> {
    if paths.len() < config.people {
        return Err(SimulationError::TooFewMotions { people: config.people, files: paths.len() });
    }
    let mut people: Vec<Person> = Vec::with_capacity(config.people);
    for (index, path) in paths[..config.people].iter().enumerate() {
        let motion = |problem| SimulationError::Motion { path: path.clone(), problem };
        let take = read_take(path).map_err(motion)?;
        let mut person = resampled(take, path, config.fps);
        cut(&mut person, config, index);
        put_on_floor(&mut person);
        people.push(person);
    }
    let n_frames = people.iter().map(|p| p.poses.len()).min().unwrap_or(0);
    people.iter_mut().for_each(|p| p.poses.truncate(n_frames));
    for index in 0..people.len() {
        let (placed, rest) = people.split_at_mut(index);
        place(&mut rest[0], placed, config, index);
    }
    Ok(people)
}

/// A file as it is.
struct Take {
    skeleton: Skeleton,
    poses: Vec<Pose>,
    fps: f64,
}

struct Array {
    shape: Vec<u64>,
    values: Vec<f64>,
}

fn read_take(path: &Path) -> Result<Take, MotionProblem> {
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
    let skeleton = match array(&mut archive, "rest_joints")? {
        None => Skeleton::generic(),
        Some(rest) if rest.shape == [N_JOINTS as u64, 3] => Skeleton::from_rest_joints(&std::array::from_fn(|j| {
            Vector3::from_column_slice(&rest.values[3 * j..3 * j + 3])
        })),
        Some(rest) => {
            return Err(MotionProblem::Shape { array: "rest_joints", expected: "(24, 3)", found: rest.shape });
        }
    };
    // In the wide layouts fingers or jaw and eyes follow the 22 body joints.
    let n_read = if width == 72 { N_JOINTS } else { 22 };
    let pose = |frame: usize| {
        let row = &poses.values[frame * width..(frame + 1) * width];
        let turn = |j: usize| rotation::exp(&Vector3::from_column_slice(&row[3 * j..3 * j + 3]));
        Pose {
            rotations: std::array::from_fn(|j| if j < n_read { turn(j) } else { Matrix3::identity() }),
            pelvis: Vector3::from_column_slice(&trans.values[3 * frame..3 * frame + 3]),
        }
    };
    let mut poses: Vec<Pose> = (0..n_frames).map(pose).collect();
    turn_y_up(&mut poses);
    Ok(Take { skeleton, poses, fps })
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
    let file = npyz::NpyFile::new(member)?;
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
fn turn_y_up(poses: &mut [Pose]) {
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

/// The take at the session's rate: rotations along the geodesic, positions along the line.
fn resampled(take: Take, path: &Path, fps: f64) -> Person {
    let duration = (take.poses.len() - 1) as f64 / take.fps;
    let n_frames = (duration * fps + 1e-9).floor() as usize + 1;
    let pose = |frame: usize| {
        let at = frame as f64 / fps * take.fps;
        let first = (at.floor() as usize).min(take.poses.len() - 1);
        let (a, b) = (&take.poses[first], &take.poses[(first + 1).min(take.poses.len() - 1)]);
        let share = (at - first as f64).clamp(0.0, 1.0);
        let turn = |j: usize| {
            a.rotations[j] * rotation::exp(&(rotation::log(&(a.rotations[j].transpose() * b.rotations[j])) * share))
        };
        Pose { rotations: std::array::from_fn(turn), pelvis: a.pelvis.lerp(&b.pelvis, share) }
    };
    let source = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    Person { skeleton: take.skeleton, poses: (0..n_frames).map(pose).collect(), source }
}

/// A random window of at most the session's length.
fn cut(person: &mut Person, config: &SimulationConfig, index: usize) {
    let spare = person.poses.len().saturating_sub(config.frames);
    let start = stream(config.seed, Purpose::Motion, 0, index).random_range(0..=spare);
    person.poses.drain(..start);
    person.poses.truncate(config.frames);
    if start > 0 {
        person.source = format!("{}@{start}", person.source);
    }
}

/// Foot joints lie this high above the floor when the foot stands on it, m.
const FOOT_HEIGHT: f64 = 0.03;

/// Shifts the take in height: its lowest foot is on the floor in 95 % of all frames or higher.
fn put_on_floor(person: &mut Person) {
    let lowest_foot = |pose: &Pose| {
        let joints = person.skeleton.pose(pose).joints;
        joints[joint("left_foot")].y.min(joints[joint("right_foot")].y)
    };
    let mut heights: Vec<f64> = person.poses.iter().map(lowest_foot).collect();
    heights.sort_by(f64::total_cmp);
    let floor = heights[heights.len() / 20] - FOOT_HEIGHT;
    person.poses.iter_mut().for_each(|pose| pose.pelvis.y -= floor);
}

/// Turns and shifts a person on the floor, away from those already placed.
fn place(person: &mut Person, placed: &[Person], config: &SimulationConfig, index: usize) {
    const NEAR: f64 = 0.45;
    const FAR: f64 = 2.2;
    let mut rng = stream(config.seed, Purpose::Placement, 0, index);
    let area = if config.people > 2 { 1.0 } else { 0.6 };
    let n_frames = person.poses.len().max(1) as f64;
    let middle = person.poses.iter().map(|pose| pose.pelvis).sum::<Vector3<f64>>() / n_frames;
    let mut best = (f64::NEG_INFINITY, Matrix3::identity(), Vector3::zeros());
    for _ in 0..200 {
        let turn =
            rotation::exp(&Vector3::new(0.0, rng.random_range(-std::f64::consts::PI..std::f64::consts::PI), 0.0));
        let mut shift = Vector3::new(rng.random_range(-area..area), 0.0, rng.random_range(-area..area));
        if config.people == 1 {
            shift = Vector3::zeros();
        }
        shift -= turn * Vector3::new(middle.x, 0.0, middle.z);
        let track: Vec<Vector3<f64>> = person.poses.iter().map(|pose| turn * pose.pelvis + shift).collect();
        let floor_distance = |a: &Vector3<f64>, b: &Vector3<f64>| (a.x - b.x).hypot(a.z - b.z);
        let gaps =
            placed.iter().flat_map(|other| track.iter().zip(&other.poses).map(|(a, b)| floor_distance(a, &b.pelvis)));
        let gap = gaps.fold(9.0, f64::min);
        let far = track.iter().map(|p| p.x.abs().max(p.z.abs())).fold(0.0, f64::max);
        let score = gap.min(0.55) - 0.3 * (far - FAR).max(0.0);
        if score > best.0 {
            best = (score, turn, shift);
        }
        if gap > NEAR && far < FAR {
            break;
        }
    }
    for pose in &mut person.poses {
        pose.rotations[0] = best.1 * pose.rotations[0];
        pose.pelvis = best.1 * pose.pelvis + best.2;
    }
}
