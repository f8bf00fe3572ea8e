//! Evaluation: hidden limbs of recorded motions, completed by the denoiser and by what needs no network.

use super::bridge::{DECAY_FRAMES, bridge};
use super::chart::LocalRotations;
use super::dataset::Take;
use super::gaps::{LEGS, LIMBS};
use super::joints::{Bones, JointPositions};
use super::observed::{N_DESCRIBED, ObservedMotion, described_place, joints_below};
use super::prior::{Completion, MotionPrior};
use crate::body::skeleton::chain_to_root;
use crate::geometry::rotation::{self, exp, right_jacobian_inverse, skew};
use nalgebra::{Matrix3, Vector3};

/// What is hidden, and the joints that are hidden together.
pub const HIDDEN: [(&str, &[&[usize]]); 3] =
    [("one arm", &[LIMBS[2].1, LIMBS[3].1]), ("one leg", &[LIMBS[0].1, LIMBS[1].1]), ("both legs", &[LEGS])];
/// Lengths of the gaps, frames at 30 Hz.
pub const GAPS: [usize; 4] = [15, 30, 60, 90];
/// Frames at both ends of a take that are always seen.
const MARGIN: usize = 15;

/// Errors of the hidden joints in all gaps of one kind; means over joints and frames, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct GapErrors {
    /// What is hidden.
    pub hidden: &'static str,
    /// Length of the gaps, frames.
    pub n_frames: usize,
    /// How many gaps.
    pub n_gaps: usize,
    /// Spherical interpolation of the true local rotations.
    pub spherical_mm: f64,
    /// Cubic of the true local rotations with the velocities at the edges.
    pub cubic_mm: f64,
    /// The bridge that the denoiser corrects.
    pub bridge_mm: f64,
    /// The denoiser.
    pub denoiser_mm: f64,
    /// For each hidden joint and frame the error, m, and the stated covariance, m^2.
    pub ellipsoids: Vec<(Vector3<f64>, Matrix3<f64>)>,
}

impl GapErrors {
    /// The better of both interpolations, mm.
    pub fn baseline_mm(&self) -> f64 {
        self.spherical_mm.min(self.cubic_mm)
    }

    /// Share of the errors inside their 95 % ellipsoids when covariances are multiplied by `factor`.
    pub fn share_inside(&self, factor: f64) -> f64 {
        share_inside(&self.ellipsoids, factor)
    }
}

/// The 95 % quantile of the chi-square distribution with three degrees of freedom.
const CHI_SQUARE_95: f64 = 7.815;
/// Variance added to the joints' positions: a bone's own twist moves no joint, so that covariances are singular; 10 mm.
const POSITION_FLOOR: f64 = 1e-4;

/// Share of errors inside 95 % ellipsoids of covariances times `factor`.
pub fn share_inside(ellipsoids: &[(Vector3<f64>, Matrix3<f64>)], factor: f64) -> f64 {
    let is_inside = |(error, covariance): &&(Vector3<f64>, Matrix3<f64>)| {
        let inverse = (covariance * factor + Matrix3::identity() * POSITION_FLOOR).try_inverse();
        inverse.is_some_and(|inverse| error.dot(&(inverse * error)) <= CHI_SQUARE_95)
    };
    ellipsoids.iter().filter(is_inside).count() as f64 / ellipsoids.len().max(1) as f64
}

/// Whether a take is long enough for the shortest gaps.
pub(super) fn has_gaps(take: &Take) -> bool {
    take.rotations.len() >= GAPS[0] + 2 * MARGIN
}

/// Errors for every kind of gap. `every`: gaps left out, 1 evaluates all of them.
pub fn gap_errors(prior: &MotionPrior, takes: &[&Take], every: usize) -> Vec<GapErrors> {
    let kinds = HIDDEN.iter().flat_map(|hidden| GAPS.map(|n_frames| (*hidden, n_frames)));
    kinds.map(|(hidden, n_frames)| errors_of(prior, takes, hidden, n_frames, every)).collect()
}

fn errors_of(
    prior: &MotionPrior,
    takes: &[&Take],
    (hidden, sets): (&'static str, &[&[usize]]),
    n_frames: usize,
    every: usize,
) -> GapErrors {
    let bones = Bones::of_default_body();
    let mut sums = [0.0; 4];
    let (mut n_gaps, mut n_errors, mut ellipsoids) = (0, 0, Vec::new());
    let starts = takes.iter().flat_map(|take| {
        let last = take.rotations.len().saturating_sub(n_frames + MARGIN);
        (MARGIN..=last).step_by(n_frames + 2 * MARGIN).map(move |start| (*take, start))
    });
    let gaps = starts.flat_map(|(take, start)| sets.iter().map(move |joints| (take, start, *joints)));
    for (take, start, joints) in gaps.step_by(every) {
        let gap = Gap::new(take, start, n_frames, joints);
        let completion = prior.completed(&gap.observed);
        let rest = prior.mean_pose();
        let bridged = bridge(&gap.observed, &rest, DECAY_FRAMES).rotations;
        let paths = [gap.spherical(), gap.cubic(), bridged, completion.rotations.clone()];
        for t in gap.frames.clone() {
            let truth = bones.posed(&gap.truth[t]).joints;
            for (sum, path) in sums.iter_mut().zip(&paths) {
                let found = bones.posed(&path[t]).joints;
                *sum += gap.moved.iter().map(|&joint| (found[joint] - truth[joint]).norm()).sum::<f64>();
            }
            ellipsoids.extend(gap.moved.iter().map(|&joint| ellipsoid(&bones, &completion, &truth, t, joint, joints)));
            n_errors += gap.moved.len();
        }
        n_gaps += 1;
    }
    let [spherical_mm, cubic_mm, bridge_mm, denoiser_mm] = sums.map(|sum| 1e3 * sum / n_errors.max(1) as f64);
    GapErrors { hidden, n_frames, n_gaps, spherical_mm, cubic_mm, bridge_mm, denoiser_mm, ellipsoids }
}

/// A gap in a recorded motion, with as much of the take around it as the denoiser reads.
struct Gap {
    truth: Vec<LocalRotations>,
    observed: ObservedMotion,
    frames: std::ops::Range<usize>,
    hidden: Vec<usize>,
    /// The joints that the hidden rotations move.
    moved: Vec<usize>,
}

/// Stated standard deviation of the recorded rotations, rad: that of the cleanest motions of the training.
const SEEN_SIGMA: f64 = 0.005;
/// Frames around a gap that are cut out with it.
const CONTEXT: usize = 90;

impl Gap {
    fn new(take: &Take, start: usize, n_frames: usize, hidden: &[usize]) -> Self {
        let cut = start.saturating_sub(CONTEXT)..(start + n_frames + CONTEXT).min(take.rotations.len());
        let mut observed =
            ObservedMotion::exact(take.rotations[cut.clone()].to_vec(), take.pelvis[cut.clone()].to_vec());
        observed.sigma.iter_mut().for_each(|sigma| *sigma = [SEEN_SIGMA; N_DESCRIBED]);
        let frames = start - cut.start..start - cut.start + n_frames;
        observed.hide(hidden, frames.clone());
        let mut moved: Vec<usize> = hidden.iter().flat_map(|&joint| joints_below(joint)).collect();
        moved.sort_unstable();
        moved.dedup();
        Self { truth: take.rotations[cut].to_vec(), observed, frames, hidden: hidden.to_vec(), moved }
    }

    fn filled(&self, at: impl Fn([&Matrix3<f64>; 4], f64, f64) -> Matrix3<f64>) -> Vec<LocalRotations> {
        let mut path = self.truth.clone();
        let (before, after) = (self.frames.start - 1, self.frames.end);
        for &joint in &self.hidden {
            let edges =
                [before - 1, before, after, (after + 1).min(self.truth.len() - 1)].map(|t| &self.truth[t][joint]);
            for t in self.frames.clone() {
                path[t][joint] = at(edges, (t - before) as f64, (after - before) as f64);
            }
        }
        path
    }

    fn spherical(&self) -> Vec<LocalRotations> {
        self.filled(|[_, from, to, _], n, length| rotation::towards(from, to, n / length))
    }

    /// Hermite's cubic in the rotation vectors about the first edge, with the velocities of one frame at both edges.
    fn cubic(&self) -> Vec<LocalRotations> {
        self.filled(|[before, from, to, after], n, length| {
            let s = n / length;
            let end = rotation::step(from, to);
            let start_velocity = rotation::step(before, from) * length;
            let end_velocity = right_jacobian_inverse(&end) * rotation::step(to, after) * length;
            let (s2, s3) = (s * s, s * s * s);
            let at = start_velocity * (s3 - 2.0 * s2 + s) + end * (3.0 * s2 - 2.0 * s3) + end_velocity * (s3 - s2);
            from * exp(&at)
        })
    }
}

/// The error of a joint and its stated covariance, the sum over the hidden joints above it.
fn ellipsoid(
    bones: &Bones,
    completion: &Completion,
    truth: &JointPositions,
    t: usize,
    joint: usize,
    hidden: &[usize],
) -> (Vector3<f64>, Matrix3<f64>) {
    let posed = bones.posed(&completion.rotations[t]);
    let mut covariance = Matrix3::zeros();
    for above in chain_to_root(joint).skip(1).filter(|above| hidden.contains(above)) {
        let Some(described) = described_place(above) else { continue };
        let lever = -skew(&(posed.joints[joint] - posed.joints[above])) * posed.rotations[above];
        let own = completion.precision[t][described].try_inverse().unwrap_or_else(Matrix3::zeros);
        covariance += lever * own * lever.transpose();
    }
    (posed.joints[joint] - truth[joint], covariance)
}
