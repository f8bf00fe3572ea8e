//! People from takes, read from files or drawn from the prior: resampled, cut, put on the floor and next to each other.

use super::config::{Bodies, SimulationConfig};
use super::drawn::{drawn_take, stand};
use super::error::SimulationError;
use super::random::{Purpose, stream};
use super::skeleton::{SimulatedPerson, SimulatedSkeleton, joint};
use crate::body::default_body;
use crate::body::mocap_skeleton::retargeted;
use crate::geometry::rotation;
use crate::motion_prior::motion_file::{MotionPose, MotionTake, read_take};
use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use std::path::PathBuf;

/// One person a file, in the given order; the session is as long as the shortest take, at most `config.frames`.
///
/// Longer takes start at a random frame.
///
/// # Errors
/// [`SimulationError`] if there are too few files or one cannot be read.
pub fn people_from_files(
    paths: &[PathBuf],
    config: &SimulationConfig,
) -> Result<Vec<SimulatedPerson>, SimulationError> {
    if paths.len() < config.people {
        return Err(SimulationError::TooFewMotions { people: config.people, files: paths.len() });
    }
    let mut people: Vec<SimulatedPerson> = Vec::with_capacity(config.people);
    for (index, path) in paths[..config.people].iter().enumerate() {
        let motion = |problem| SimulationError::Motion { path: path.clone(), problem };
        let take = read_take(path).map_err(motion)?;
        let skeleton =
            take.rest_joints.as_ref().map_or_else(SimulatedSkeleton::generic, SimulatedSkeleton::from_rest_joints);
        let source = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let body = match config.bodies {
            Bodies::Own => SimulatedPerson::of_skeleton(skeleton, source),
            Bodies::Default | Bodies::Individual => SimulatedPerson::still(config, index, &source),
        };
        let mut person = resampled(take, body, config.fps);
        cut(&mut person, config, index);
        put_on_floor(&mut person);
        people.push(person);
    }
    Ok(placed(people, config))
}

/// People with motions drawn from the prior, each with a random body.
pub fn people_from_prior(config: &SimulationConfig) -> Vec<SimulatedPerson> {
    let person = |index: usize| {
        let mut person =
            resampled(drawn_take(config, index), SimulatedPerson::still(config, index, "prior"), config.fps);
        person.poses.truncate(config.frames);
        stand(&mut person, config.fps, FOOT_HEIGHT);
        person
    };
    placed((0..config.people).map(person).collect(), config)
}

/// Shifts and turns people on the floor so that they share the space: 0.45 m apart, if a position is found within 200 tries,
/// and within 2.2 m of the centre. All takes are cut to the shortest.
fn placed(mut people: Vec<SimulatedPerson>, config: &SimulationConfig) -> Vec<SimulatedPerson> {
    let n_frames = people.iter().map(|p| p.poses.len()).min().unwrap_or(0);
    people.iter_mut().for_each(|p| p.poses.truncate(n_frames));
    for index in 0..people.len() {
        let (placed, rest) = people.split_at_mut(index);
        place(&mut rest[0], placed, config, index);
    }
    people
}

/// A person with the motion of a take at the session's frame rate: rotations along the geodesic, positions linear. Rotations
/// of a default body are retargeted from the mocap skeleton.
fn resampled(take: MotionTake, body: SimulatedPerson, fps: f64) -> SimulatedPerson {
    let mocap_from_body = body.betas.map(|_| default_body().mocap_from_body);
    let duration = (take.poses.len() - 1) as f64 / take.fps;
    let n_frames = (duration * fps + 1e-9).floor() as usize + 1;
    let pose = |frame: usize| {
        let at = frame as f64 / fps * take.fps;
        let first = (at.floor() as usize).min(take.poses.len() - 1);
        let (a, b) = (&take.poses[first], &take.poses[(first + 1).min(take.poses.len() - 1)]);
        let share = (at - first as f64).clamp(0.0, 1.0);
        let turn = |j: usize| {
            let mocap = rotation::towards(&a.rotations[j], &b.rotations[j], share);
            mocap_from_body.as_ref().map_or(mocap, |mocap_from_body| retargeted(&mocap, j, mocap_from_body))
        };
        MotionPose { rotations: std::array::from_fn(turn), pelvis: a.pelvis.lerp(&b.pelvis, share) }
    };
    SimulatedPerson { poses: (0..n_frames).map(pose).collect(), ..body }
}

/// A random window of at most the session's length.
fn cut(person: &mut SimulatedPerson, config: &SimulationConfig, index: usize) {
    let spare = person.poses.len().saturating_sub(config.frames);
    let start = stream(config.seed, Purpose::Motion, 0, index).random_range(0..=spare);
    person.poses.drain(..start);
    person.poses.truncate(config.frames);
    if start > 0 {
        person.source = format!("{}@{start}", person.source);
    }
}

/// Height of foot joints above the floor when the foot stands on it, m.
const FOOT_HEIGHT: f64 = 0.03;

/// Shifts the take in height so that its lowest foot is on the floor or above it in 95 % of all frames.
fn put_on_floor(person: &mut SimulatedPerson) {
    let lowest_foot = |pose: &MotionPose| {
        let joints = person.skeleton.pose(pose).joints;
        joints[joint("left_foot")].y.min(joints[joint("right_foot")].y)
    };
    let mut heights: Vec<f64> = person.poses.iter().map(lowest_foot).collect();
    heights.sort_by(f64::total_cmp);
    let floor = heights[heights.len() / 20] - FOOT_HEIGHT;
    person.poses.iter_mut().for_each(|pose| pose.pelvis.y -= floor);
}

/// Turns and shifts a person on the floor, away from those that are already placed.
fn place(person: &mut SimulatedPerson, placed: &[SimulatedPerson], config: &SimulationConfig, index: usize) {
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
