//! Motions drawn from the motion prior.
//!
//! The prior describes joint rotations, not the position of the body. A drawn body turns randomly about the vertical and
//! stands on its lower foot: the path of the pelvis is the one that keeps this foot at rest.

use super::config::SimulationConfig;
use super::random::{Purpose, stream};
use super::skeleton::{SimulatedPerson, SimulatedSkeleton, joint};
use crate::body::human_speeds::JOG_M_S;
use crate::geometry::rotation;
use crate::motion_prior::MotionPrior;
use crate::motion_prior::chart::LocalRotations;
use crate::motion_prior::dataset::GRID_FPS;
use crate::motion_prior::motion_file::{MotionPose, MotionTake};
use nalgebra::Vector3;
use rand::RngExt;
use std::f64::consts::{PI, TAU};

/// A random take for one person, as long as the session; its pelvis is at the origin.
pub(super) fn drawn_take(config: &SimulationConfig, person: usize) -> MotionTake {
    let rng = &mut stream(config.seed, Purpose::Motion, 0, person);
    let prior = MotionPrior::embedded();
    let n_frames = (config.frames as f64 / config.fps * GRID_FPS).ceil() as usize + 1;
    let drawn = prior.drawn(n_frames, rng.random());
    let heading = random_heading(rng);
    let pose = |(t, mut rotations): (usize, LocalRotations)| {
        rotations[0] = rotation::exp(&(Vector3::y() * heading(t as f64 / GRID_FPS)));
        MotionPose { rotations, pelvis: Vector3::zeros() }
    };
    let poses = drawn.into_iter().enumerate().map(pose).collect();
    MotionTake { rest_joints: None, poses, fps: GRID_FPS }
}

/// Heading over time, rad: two slow waves, at most some 60 degrees a second.
fn random_heading(rng: &mut rand_chacha::ChaCha8Rng) -> impl Fn(f64) -> f64 + use<> {
    let waves: [[f64; 3]; 2] = [0.05, 0.13]
        .map(|hertz| [rng.random_range(0.3..1.0), hertz * rng.random_range(0.7..1.3), rng.random_range(0.0..TAU)]);
    let start = rng.random_range(-PI..PI);
    move |seconds| {
        start + waves.iter().map(|[size, hertz, phase]| size * (TAU * hertz * seconds + phase).sin()).sum::<f64>()
    }
}

/// Feet whose heights differ by less than this both bear weight, m.
const SHARED_WEIGHT: f64 = 0.03;
/// Time within which a person who drifts away returns to the centre, s.
const RETURN_TIME: f64 = 4.0;
/// Standard deviation of the kernel that smooths the body's path, s.
const INERTIA: f64 = 0.1;

/// Sets a person's path: the lower foot's joint is at rest, `foot_height` m above the floor.
pub(super) fn stand(person: &mut SimulatedPerson, fps: f64, foot_height: f64) {
    let feet: Vec<[Vector3<f64>; 2]> = person.poses.iter().map(|pose| feet(&person.skeleton, pose)).collect();
    let mut path = Vec::with_capacity(feet.len());
    let mut place = Vector3::zeros();
    for (t, now) in feet.iter().enumerate() {
        let weights = weights(now);
        let before = &feet[t.saturating_sub(1)];
        let slide = (now[0] - before[0]) * weights[0] + (now[1] - before[1]) * weights[1];
        let velocity = -slide * fps - place / RETURN_TIME;
        let horizontal = Vector3::new(velocity.x, 0.0, velocity.z);
        place += horizontal * ((JOG_M_S / horizontal.norm().max(JOG_M_S)) / fps);
        let lowest = now[0].y * weights[0] + now[1].y * weights[1];
        path.push(Vector3::new(place.x, foot_height - lowest, place.z));
    }
    for (pose, place) in person.poses.iter_mut().zip(smoothed(&path, INERTIA * fps)) {
        pose.pelvis = place;
    }
}

/// Foot joints relative to the pelvis, m.
fn feet(skeleton: &SimulatedSkeleton, pose: &MotionPose) -> [Vector3<f64>; 2] {
    let joints = skeleton.pose(&MotionPose { pelvis: Vector3::zeros(), ..*pose }).joints;
    ["left_foot", "right_foot"].map(|name| joints[joint(name)])
}

/// Share of the weight that each foot bears.
fn weights(feet: &[Vector3<f64>; 2]) -> [f64; 2] {
    let left = 1.0 / (1.0 + ((feet[0].y - feet[1].y) / SHARED_WEIGHT).exp());
    [left, 1.0 - left]
}

/// The path smoothed by a Gaussian kernel of `sigma` frames, truncated at three sigma and at the ends.
fn smoothed(path: &[Vector3<f64>], sigma: f64) -> Vec<Vector3<f64>> {
    let reach = (3.0 * sigma).ceil() as usize;
    let at = |t: usize| {
        let near = t.saturating_sub(reach)..(t + reach + 1).min(path.len());
        let weight = |s: usize| (-0.5 * ((s as f64 - t as f64) / sigma).powi(2)).exp();
        let sum: Vector3<f64> = near.clone().map(|s| path[s] * weight(s)).sum();
        sum / near.map(weight).sum::<f64>()
    };
    (0..path.len()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::super::simulate;
    use super::*;
    use crate::simulation::{MotionSource, Preset};

    #[test]
    fn drawn_people_stand_near_the_middle_and_differ() {
        let preset = SimulationConfig::preset(Preset::Easy);
        let config = SimulationConfig { people: 3, frames: 300, motion: MotionSource::Prior, ..preset };
        let truth = simulate(&config).unwrap().truth;
        let lowest = |joints: &[Vector3<f64>; 24]| joints.iter().map(|j| j.y).fold(f64::INFINITY, f64::min);
        for person in 0..3 {
            let mut heights: Vec<f64> = truth.joints.iter().map(|frame| lowest(&frame[person])).collect();
            heights.sort_by(f64::total_cmp);
            assert!((-0.1..0.1).contains(&heights[150]), "{}", heights[150]);
            let far = truth.joints.iter().map(|frame| frame[person][0].xz().norm()).fold(0.0, f64::max);
            assert!(far < 3.5, "{far}");
            let turn = |t: usize| truth.people[person].poses[t].rotations[16];
            assert!(rotation::log(&(turn(10).transpose() * turn(200))).norm() > 0.05, "joints move");
        }
        assert_ne!(truth.people[0].poses[5].rotations[4], truth.people[1].poses[5].rotations[4]);
        assert_eq!(truth.joints.len(), 300);
    }
}
