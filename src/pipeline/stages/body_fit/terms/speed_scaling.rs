//! Speed-scaled smoothness: the standard deviation of accelerations as a function of speed.
//!
//! Slow parts of the body accelerate little, fast ones much. Over CMU's takes the accelerations of one joint spread by a
//! factor of 3 to 5 (standard deviation of their logarithm 1.0 to 1.6), at a known speed by one of 2 (0.65 to 0.7): with
//! the speed `p` their median `a` grows from a quarter to five times that of the typical speed,
//! $a(p) = a_0 ((p / p_0)^2 + f^2)^{q/2}$.

use crate::body::kinematics::Pose;
use crate::geometry::rotation;
use nalgebra::Vector3;

/// The power $q$: 0.6 of the pelvis to 0.85 of the ankles.
const POWER: f64 = 0.75;

/// The floor $f$: speeds below a tenth of the typical one count as standing.
const FLOOR: f64 = 0.1;

/// Speeds are means over this much time before and after, s: a swing is slow where it reverses, but not at rest.
const HALF_WINDOW_SECS: f64 = 1.0 / 15.0;

/// Sigma of accelerations over that at the typical speed; `speed` in typical speeds.
pub(crate) fn sigma_growth(speed: f64) -> f64 {
    (speed * speed + FLOOR * FLOOR).powf(0.5 * POWER)
}

/// Root mean square speeds about each of `n` frames, `dt` s apart; `moved(a, b)`: displacement between two frames.
pub(crate) fn speeds(n: usize, dt: f64, moved: impl Fn(usize, usize) -> Vector3<f64>) -> Vec<f64> {
    let half = (HALF_WINDOW_SECS / dt).round().max(1.0) as usize;
    let window = |t: usize| (t.saturating_sub(half), (t + half).min(n - 1));
    let squared_speed = |t: usize| {
        let (a, b) = window(t);
        moved(a, b).norm_squared() / ((b - a).max(1) as f64 * dt).powi(2)
    };
    let squared: Vec<f64> = (0..n).map(squared_speed).collect();
    let mean = |t: usize| {
        let (a, b) = window(t);
        squared[a..=b].iter().sum::<f64>() / (b - a + 1) as f64
    };
    (0..n).map(|t| mean(t).sqrt()).collect()
}

/// Angular [`speeds`] of a joint, rad/s.
pub(crate) fn rotation_speeds(poses: &[Pose], joint: usize, dt: f64) -> Vec<f64> {
    let turned = |a: usize, b: usize| rotation::step(&poses[a].rotations[joint], &poses[b].rotations[joint]);
    speeds(poses.len(), dt, turned)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the ends of the motion, too.
    #[test]
    fn constant_speed_is_found_at_any_frame_rate() {
        for dt in [1.0 / 25.0, 1.0 / 120.0] {
            let moved = |a: usize, b: usize| Vector3::new(0.0, 1.5, 2.0) * ((b - a) as f64 * dt);
            assert!(speeds(20, dt, moved).iter().all(|speed| (speed - 2.5).abs() < 1e-12));
        }
        assert_eq!(speeds(1, 0.04, |_, _| Vector3::zeros()), [0.0]);
    }

    #[test]
    fn sigmas_grow_with_the_speed() {
        assert!((sigma_growth(1.0) - 1.0).abs() < 0.01);
        assert!(sigma_growth(0.0) < 0.2 && sigma_growth(10.0) > 5.0);
    }

    /// The speed is zero for a moment at the end of a swing.
    #[test]
    fn a_reversing_swing_is_not_at_rest() {
        let (dt, swing) = (1.0 / 30.0, |t: usize| Vector3::x() * (0.4 * t as f64).cos());
        let at_the_reversal = speeds(40, dt, |a, b| swing(b) - swing(a))[16];
        let fastest = 0.4 / dt;
        assert!(at_the_reversal > 0.3 * fastest, "{at_the_reversal} of {fastest}");
    }
}
