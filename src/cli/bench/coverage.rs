//! Whether stated standard deviations are those of the errors.

use crate::body::skeleton::N_JOINTS;
use crate::evaluation::alignment::{Alignment, truth_from_solved};
use crate::evaluation::camera_error::{CameraPair, camera_errors};
use crate::geometry::Similarity;
use crate::optim::robust::INTERVAL_95;
use crate::session::people::BodyPose;
use crate::session::reconstruction::{PersonReport, SolvedCamera};
use crate::session::{BodyMotion, JointTrajectory, Reconstruction};
use crate::simulation::Simulated;
use nalgebra::Vector3;
use std::fmt;

/// Errors of one quantity over their stated standard deviations.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Coverage {
    n: usize,
    /// Within the 95 % interval.
    n_inside: usize,
    sum_of_squares: f64,
}

impl Coverage {
    pub(super) fn add(&mut self, error: f64, sigma: f64) {
        let ratio = error / sigma;
        self.n += 1;
        self.n_inside += usize::from(ratio <= INTERVAL_95);
        self.sum_of_squares += ratio * ratio;
    }

    fn merge(&mut self, other: &Self) {
        self.n += other.n;
        self.n_inside += other.n_inside;
        self.sum_of_squares += other.sum_of_squares;
    }

    fn line(&self) -> String {
        let n = self.n.max(1) as f64;
        let (inside, rms) = (100.0 * self.n_inside as f64 / n, (self.sum_of_squares / n).sqrt());
        format!("{inside:5.1} % of {:7} in the 95 % interval, rms error over sigma {rms:.2}", self.n)
    }
}

/// Of all that a result states, after the similarity alignment of the camera centres.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Coverages {
    positions: Coverage,
    orientations: Coverage,
    joints: Coverage,
    keypoints: Coverage,
}

impl Coverages {
    /// Of a result with all cameras solved; `pairs` in the order of the views.
    pub(super) fn of(simulated: &Simulated, result: &Reconstruction, pairs: &[CameraPair]) -> Self {
        let mut coverages = Self::default();
        coverages.add_cameras(pairs, &result.cameras);
        let (solved, truth): (Vec<_>, Vec<_>) = pairs.iter().map(|pair| (pair.solved, pair.truth)).unzip();
        let truth_from_solved = truth_from_solved(&solved, &truth, Alignment::Sim3);
        for ((motion, keypoints), report) in result.motions.iter().zip(&result.keypoints).zip(&result.report.people) {
            let Some(person) = true_person(motion, simulated, &truth_from_solved) else { continue };
            coverages.add_joints(motion, person, simulated, &truth_from_solved);
            coverages.add_keypoints(keypoints, report, person, simulated, &truth_from_solved);
        }
        coverages
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.positions.merge(&other.positions);
        self.orientations.merge(&other.orientations);
        self.joints.merge(&other.joints);
        self.keypoints.merge(&other.keypoints);
    }

    fn add_cameras(&mut self, pairs: &[CameraPair], solved: &[SolvedCamera]) {
        let errors = camera_errors(pairs, &[], Alignment::Sim3);
        for (pair, camera) in pairs.iter().zip(solved) {
            let error = &errors.per_camera[&pair.id];
            if let (Some(position), Some(angle)) = (camera.sigma_position_mm, camera.sigma_angle_deg) {
                self.positions.add(error.position_mm, position);
                self.orientations.add(error.angle_deg, angle);
            }
        }
    }

    fn add_joints(&mut self, motion: &BodyMotion, person: usize, simulated: &Simulated, by: &Similarity) {
        let Some(sigmas) = &motion.joint_sigmas else { return };
        let rows = motion.frames.iter().zip(sigmas).zip(simulated.truth.joints.iter().skip(motion.first.0));
        for ((pose, sigmas), truth) in rows {
            for joint in 0..N_JOINTS {
                self.joints.add((by.transform(&pose.joints[joint]) - truth[person][joint]).norm(), sigmas[joint]);
            }
        }
    }

    /// Of points that two views see, against the median over frames that the report states for their kind.
    fn add_keypoints(
        &mut self,
        keypoints: &JointTrajectory,
        report: &PersonReport,
        person: usize,
        simulated: &Simulated,
        by: &Similarity,
    ) {
        let rows = keypoints.points.iter().zip(&keypoints.n_views);
        for ((points, n_views), truth) in rows.zip(simulated.truth.keypoints.iter().skip(keypoints.first.0)) {
            for (k, statistics) in report.keypoints.iter().enumerate().filter(|(k, _)| n_views[*k] > 1) {
                if let (Some(point), Some(sigma)) = (points[k], statistics.sigma_mm) {
                    self.keypoints.add(1e3 * (by.transform(&point) - truth[person][k]).norm(), sigma.median);
                }
            }
        }
    }
}

impl fmt::Display for Coverages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  camera positions:    {}", self.positions.line())?;
        writeln!(f, "  camera orientations: {}", self.orientations.line())?;
        writeln!(f, "  joints of bodies:    {}", self.joints.line())?;
        write!(f, "  keypoints:           {}", self.keypoints.line())
    }
}

/// Farthest that a person's pelvis is on average from that of the true person, m.
const SAME_PERSON: f64 = 0.5;

/// The true person whose pelvis is nearest on average.
fn true_person(motion: &BodyMotion, simulated: &Simulated, by: &Similarity) -> Option<usize> {
    let distance = |person: usize| {
        let truth = simulated.truth.joints.iter().skip(motion.first.0);
        let gap = |(pose, truth): (&BodyPose, &Vec<[Vector3<f64>; N_JOINTS]>)| {
            (by.transform(&pose.joints[0]) - truth[person][0]).norm()
        };
        motion.frames.iter().zip(truth).map(gap).sum::<f64>() / motion.frames.len().max(1) as f64
    };
    let people = (0..simulated.truth.people.len()).map(|person| (person, distance(person)));
    let nearest = people.min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.filter(|(_, distance)| *distance < SAME_PERSON).map(|(person, _)| person)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_counts_what_lies_inside_and_the_size_of_errors() {
        let mut coverage = Coverage::default();
        [(1.0, 1.0), (1.0, 2.0), (6.0, 2.0)].iter().for_each(|(error, sigma)| coverage.add(*error, *sigma));
        let expected = ((1.0 + 0.25 + 9.0) / 3.0_f64).sqrt();
        assert_eq!((coverage.n, coverage.n_inside), (3, 2));
        assert!(coverage.line().ends_with(&format!("{expected:.2}")), "{}", coverage.line());
    }
}
