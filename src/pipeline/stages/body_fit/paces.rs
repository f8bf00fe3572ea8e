//! How large accelerations are taken to be, from how fast things move.
//!
//! What stands, stands still, and what is fast changes fast. Over CMU's takes the accelerations of one joint spread by a
//! factor of 3 to 5 (standard deviation of their logarithm 1.0 to 1.6), at a known pace by one of 2 (0.65 to 0.7): with the
//! pace `p` their median `a` grows from a quarter to five times that of the typical pace,
//! $a(p) = a_0 ((p / p_0)^2 + f^2)^{q/2}$.

use super::BodyFitConfig;
use super::motion_problem::{MotionProblem, MotionState};
use crate::body::joint_ranges::JointRange;
use crate::body::kinematics::posed;
use crate::body::skeleton::N_JOINTS;
use crate::geometry::rotation;
use nalgebra::Vector3;

/// Typical paces $p_0$ (medians over CMU's takes): of the pelvis and of an ankle, m/s.
const PELVIS_PACE: f64 = 0.27;
const ANKLE_PACE: f64 = 0.10;

/// That of a turn over its typical acceleration, s: of spine, neck, hip, shoulder, elbow, ankle alike within a third.
const TURN_SECS: f64 = 0.08;

/// The power $q$: 0.6 of the pelvis to 0.85 of the ankles.
const POWER: f64 = 0.75;

/// The floor $f$: what is slower than a tenth of the typical pace stands.
const FLOOR: f64 = 0.1;

/// A pace is a mean over this much time before and after, s: where a swing turns round it is slow, but not at rest.
const HALF_WINDOW_SECS: f64 = 1.0 / 15.0;

/// The sizes of one frame's accelerations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AccelerationSizes {
    /// Of the pelvis, m/s^2.
    pub pelvis: f64,
    /// Of the turns, rad/s^2.
    pub turns: [f64; N_JOINTS],
    /// Of the ankles, m/s^2.
    pub ankles: [f64; 2],
}

impl AccelerationSizes {
    /// At typical paces.
    pub(super) fn typical(config: &BodyFitConfig, ranges: &[JointRange; N_JOINTS]) -> Self {
        Self {
            pelvis: config.translation_acceleration,
            turns: ranges.each_ref().map(|range| range.acceleration * config.angular_acceleration_factor),
            ankles: [config.ankle_acceleration; 2],
        }
    }
}

impl MotionProblem<'_> {
    /// The same with accelerations as large as the paces of `state` make them, where human motion is known.
    pub(super) fn paced_by(mut self, state: &MotionState) -> Self {
        if !self.config.motion_prior {
            return self;
        }
        let (poses, dt) = (&state.poses, self.frame_interval);
        let n = poses.len();
        let way = |a: usize, b: usize| poses[b].translation - poses[a].translation;
        for (sizes, pace) in self.sizes.iter_mut().zip(paces(n, dt, way)) {
            sizes.pelvis *= growth(pace / PELVIS_PACE);
        }
        for &joint in &self.active {
            let turn = |a: usize, b: usize| {
                rotation::log(&(poses[a].rotations[joint].transpose() * poses[b].rotations[joint]))
            };
            let typical = TURN_SECS * self.ranges[joint].acceleration;
            for (sizes, pace) in self.sizes.iter_mut().zip(paces(n, dt, turn)) {
                sizes.turns[joint] *= growth(pace / typical);
            }
        }
        let body = self.model.shaped(&state.betas);
        let places: Vec<Vec<Vector3<f64>>> =
            poses.iter().map(|pose| self.steady_positions(&body, &posed(&body, pose))).collect();
        for k in 0..self.steady.len() {
            let way = |a: usize, b: usize| places[b][k] - places[a][k];
            for (sizes, pace) in self.sizes.iter_mut().zip(paces(n, dt, way)) {
                sizes.ankles[k] *= growth(pace / ANKLE_PACE);
            }
        }
        self
    }
}

/// Accelerations over those of the typical pace; `pace` in typical ones.
fn growth(pace: f64) -> f64 {
    (pace * pace + FLOOR * FLOOR).powf(0.5 * POWER)
}

/// Root mean square speeds about each of `n` frames, `dt` s apart; `way(a, b)`: what lies between two frames.
fn paces(n: usize, dt: f64, way: impl Fn(usize, usize) -> Vector3<f64>) -> Vec<f64> {
    let half = (HALF_WINDOW_SECS / dt).round().max(1.0) as usize;
    let window = |t: usize| (t.saturating_sub(half), (t + half).min(n - 1));
    let squared_speed = |t: usize| {
        let (a, b) = window(t);
        way(a, b).norm_squared() / ((b - a).max(1) as f64 * dt).powi(2)
    };
    let squared: Vec<f64> = (0..n).map(squared_speed).collect();
    let mean = |t: usize| {
        let (a, b) = window(t);
        squared[a..=b].iter().sum::<f64>() / (b - a + 1) as f64
    };
    (0..n).map(|t| mean(t).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A steady speed is its own pace, whatever the frame rate; at the ends, too.
    #[test]
    fn a_pace_is_a_speed() {
        for dt in [1.0 / 25.0, 1.0 / 120.0] {
            let way = |a: usize, b: usize| Vector3::new(0.0, 1.5, 2.0) * ((b - a) as f64 * dt);
            assert!(paces(20, dt, way).iter().all(|pace| (pace - 2.5).abs() < 1e-12));
        }
        assert_eq!(paces(1, 0.04, |_, _| Vector3::zeros()), [0.0]);
    }

    /// What stands takes next to no accelerations for likely, what runs large ones.
    #[test]
    fn accelerations_grow_with_the_pace() {
        assert!((growth(1.0) - 1.0).abs() < 0.01);
        assert!(growth(0.0) < 0.2 && growth(10.0) > 5.0);
    }

    /// The end of a swing, where the speed is zero for a moment, is no rest.
    #[test]
    fn a_swing_that_turns_round_is_not_at_rest() {
        let (dt, swing) = (1.0 / 30.0, |t: usize| Vector3::x() * (0.4 * t as f64).cos());
        let at_the_turn = paces(40, dt, |a, b| swing(b) - swing(a))[16];
        let fastest = 0.4 / dt;
        assert!(at_the_turn > 0.3 * fastest, "{at_the_turn} of {fastest}");
    }
}
