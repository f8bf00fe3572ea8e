//! Smooth random motion of fingers and wrists: sums of sines of random frequency and phase.

use crate::body::hand::{FingerAngles, N_HINGES, Side, hinge_ranges, hinges};
use crate::geometry::rotation::exp;
use crate::motion_prior::motion_file::MotionPose;
use crate::simulation::config::SimulationConfig;
use crate::simulation::random::{Purpose, stream};
use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Sines of a course.
const N_SINES: usize = 3;
/// Frequencies of fingers and wrists, Hz: gestures and grasps last half a second to some seconds. Chosen.
const FREQUENCIES: [f64; 2] = [0.1, 0.7];
/// Share of a finger's flexion that all fingers of the hand have in common; its square, and that of the rest, sum to one.
/// Fingers bend together: the first synergy of grasping explains more than half of the variance (Santello et al., J. Neurosci.
/// 18, 1998).
const SHARED: f64 = 0.75;
/// The last joint of a finger bends by this share of the middle one (Rijpkema and Girard, SIGGRAPH 1991).
const LAST_OF_MIDDLE: f64 = 2.0 / 3.0;
/// Standard deviation of a wrist's rotation per axis, rad: twist, sideways, bending. Chosen: a third of the range.
const WRIST_SD: f64 = 0.35;

/// A random course of mean 0 and variance 1.
struct Course([[f64; 2]; N_SINES]);

impl Course {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        Self(std::array::from_fn(|_| [rng.random_range(FREQUENCIES[0]..FREQUENCIES[1]), rng.random_range(0.0..TAU)]))
    }

    /// At a time, s.
    fn at(&self, time: f64) -> f64 {
        let sines = self.0.iter().map(|[frequency, phase]| (TAU * frequency * time + phase).sin());
        sines.sum::<f64>() * (2.0 / N_SINES as f64).sqrt()
    }
}

/// The angles of one hand over time.
pub(in crate::simulation) struct FingerMotion {
    shared: Course,
    own: Vec<Course>,
}

impl FingerMotion {
    pub(in crate::simulation) fn new(config: &SimulationConfig, person: usize, side: Side) -> Self {
        let rng = &mut stream(config.seed, Purpose::Fingers, side as usize, person);
        Self { shared: Course::new(rng), own: (0..N_HINGES).map(|_| Course::new(rng)).collect() }
    }

    /// At a time, s; within the ranges of the hinges.
    pub(in crate::simulation) fn at(&self, time: f64) -> FingerAngles {
        let (shared, ranges) = (self.shared.at(time), hinge_ranges());
        let mut angles: FingerAngles = [0.0; N_HINGES];
        for (h, hinge) in hinges().iter().enumerate() {
            let own = self.own[h].at(time);
            let course = if hinge.is_flexion { SHARED * shared + (1.0 - SHARED * SHARED).sqrt() * own } else { own };
            let free = ranges[h].rest + ranges[h].spread * course;
            let is_last = hinge.place == 2 && hinge.finger < 4;
            let angle = if is_last { LAST_OF_MIDDLE * angles[h - 1] + 0.2 * ranges[h].spread * own } else { free };
            angles[h] = angle.clamp(ranges[h].min, ranges[h].max);
        }
        angles
    }
}

/// Turns the wrists of a motion by smooth random rotations.
pub(in crate::simulation) fn turn_wrists(poses: &mut [MotionPose], config: &SimulationConfig, person: usize) {
    for side in Side::BOTH {
        let rng = &mut stream(config.seed, Purpose::Wrists, side as usize, person);
        let courses: [Course; 3] = std::array::from_fn(|_| Course::new(rng));
        for (frame, pose) in poses.iter_mut().enumerate() {
            let time = frame as f64 / config.fps;
            let turn = Vector3::from_fn(|axis, _| WRIST_SD * courses[axis].at(time));
            pose.rotations[side.wrist()] *= exp(&turn);
        }
    }
}
