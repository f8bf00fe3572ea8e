//! Errors of joint angles against truth, and whether their stated standard deviations hold.

use crate::body::BodyModel;
use crate::body::joint_angles::{N_ANGLES, angle_names, angle_sigmas, joint_angles};
use crate::body::model::Betas;
use crate::motion_prior::motion_file::MotionPose;
use crate::optim::robust::INTERVAL_95;
use crate::session::BodyMotion;
use std::f64::consts::{PI, TAU};
use std::fmt;

/// Sums over the frames of all people.
#[derive(Clone, Copy, Default)]
struct AngleSums {
    n: f64,
    /// rad
    absolute: f64,
    /// rad^2
    squared: f64,
    /// Stated variances, rad^2.
    stated: f64,
    /// Errors within the 95 % interval.
    n_inside: f64,
}

/// Errors of all angles.
pub(super) struct AngleErrors([AngleSums; N_ANGLES]);

impl AngleErrors {
    pub(super) fn none() -> Self {
        Self([AngleSums::default(); N_ANGLES])
    }

    /// Adds the frames of a motion; `betas` and `poses` (by frame of the session) are the truth. The world has y up.
    pub(super) fn add(&mut self, model: &BodyModel, motion: &BodyMotion, betas: &Betas, poses: &[MotionPose]) {
        let true_rest = model.shaped(betas).rest_joints;
        let rest = model.shaped(&Betas::from(motion.betas)).rest_joints;
        let Some(sigmas) = &motion.joint_sigmas else { return };
        for (i, (pose, sigmas)) in motion.frames.iter().zip(sigmas).enumerate() {
            let Some(truth) = poses.get(motion.first.0 + i) else { continue };
            let expected = joint_angles(&true_rest, &truth.rotations);
            let found = joint_angles(&rest, &pose.rotations);
            let stated = angle_sigmas(&found, &rest, sigmas);
            for (k, sums) in self.0.iter_mut().enumerate() {
                let error = (found[k] - expected[k] + PI).rem_euclid(TAU) - PI;
                sums.n += 1.0;
                sums.absolute += error.abs();
                sums.squared += error * error;
                sums.stated += stated[k] * stated[k];
                sums.n_inside += if error.abs() <= INTERVAL_95 * stated[k] { 1.0 } else { 0.0 };
            }
        }
    }
}

impl fmt::Display for AngleErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let degrees = |sum: f64, n: f64| (sum / n.max(1.0)).to_degrees();
        let root = |sum: f64, n: f64| (sum / n.max(1.0)).sqrt().to_degrees();
        writeln!(
            f,
            "joint angles: mean error, its root mean square, the stated standard deviation, deg; share in the 95 % interval:"
        )?;
        for (name, s) in angle_names().iter().zip(&self.0) {
            let inside = 100.0 * s.n_inside / s.n.max(1.0);
            let (mean, rms, stated) = (degrees(s.absolute, s.n), root(s.squared, s.n), root(s.stated, s.n));
            writeln!(f, "  {name:<28} {mean:6.2} {rms:6.2} {stated:6.2} {inside:6.1} %")?;
        }
        let total = |part: fn(&AngleSums) -> f64| self.0.iter().map(part).sum::<f64>();
        let n = total(|s| s.n);
        let (mean, inside) = (degrees(total(|s| s.absolute), n), 100.0 * total(|s| s.n_inside) / n.max(1.0));
        write!(f, "  {:<28} {mean:6.2} {:6} {:6} {inside:6.1} %", "all", "", "")
    }
}
