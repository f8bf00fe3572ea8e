//! Evaluation of a prior on takes outside its training set. Joints of the default skeleton without the root, mm.

use super::chart::{LocalRotations, N_FEATURES};
use super::clips::smooth_code;
use super::corruption::{Corruption, HOLE_FRAMES, LIMBS, corrupted};
use super::dataset::{GRID_FPS, Take};
use super::interpolation::{resampled, resampled_len};
use super::joints::{Bones, JointPositions, rows};
use super::objective::{excess, joints_of};
use super::paths::{CANDIDATES, Observed, Smoothing, autoregressed, smoothed};
use super::prior::MotionPrior;
use super::self_contact::SelfContact;
use crate::body::joint_ranges::joint_ranges;
use crate::body::skeleton::{N_JOINTS, PARENTS};
use crate::geometry::rotation;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Joint errors of takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointErrors {
    /// Mean over frames and 23 joints, mm.
    pub mean_mm: f64,
    /// 95th percentile of all joint errors, mm.
    pub p95_mm: f64,
    /// Mean acceleration of the joints divided by that of the truth.
    pub acceleration_ratio: f64,
}

/// Errors in one task: the prior and baselines with the same input.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskErrors {
    /// Errors of the posterior's mean.
    pub prior: JointErrors,
    /// Mean error of each smoothing, which also interpolates unseen joints, mm.
    pub smoothings_mm: Vec<(Smoothing, f64)>,
    /// Mean error of a second-order autoregression, mm.
    pub autoregression_mm: f64,
}

impl TaskErrors {
    /// Error of the best smoothing, chosen by the true error, mm: a stricter baseline than any choice without it.
    pub fn best_smoothing_mm(&self) -> f64 {
        self.smoothings_mm.iter().map(|(_, error)| *error).fold(f64::INFINITY, f64::min)
    }
}

/// Distribution of the codes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LatentStatistics {
    /// Mean over dimensions of the mean square of a sampled z.
    pub mean_square: f64,
    /// Smallest mean square over dimensions.
    pub min_square: f64,
    /// Largest mean square over dimensions.
    pub max_square: f64,
    /// KL from N(0, I) per frame and dimension, nats.
    pub kl: f64,
    /// Root mean square of `z_(t+1) - 2 z_t + z_(t-1)` of the mean.
    pub acceleration: f64,
}

/// Statistics of motions decoded from N(0, I), smoothed in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleStatistics {
    /// Share of frames with all joints within their ranges ([`joint_ranges`]).
    pub within_limits: f64,
    /// The same with ranges widened by 10 degrees.
    pub within_limits_and_10_deg: f64,
    /// Share of frames in which the body penetrates itself by more than [`DEEP`].
    pub penetrating: f64,
    /// Standard deviation of the lower foot's height relative to the pelvis, m.
    pub foot_height_spread: f64,
}

/// Smallest capsule overlap that counts as penetration, m. Hanging arms overlap the waist by 2 to 5 cm in a third of the mocap
/// frames, since the default body is not that of the recorded subjects.
pub const DEEP: f64 = 0.05;

/// Share of the takes' frames in which the body penetrates itself by more than [`DEEP`].
pub fn penetrating_share(takes: &[Take]) -> f64 {
    let contact = SelfContact::of_default_body();
    let frames: Vec<&LocalRotations> = takes.iter().flat_map(|take| &take.rotations).collect();
    frames.iter().filter(|frame| contact.depth(frame) > DEEP).count() as f64 / frames.len().max(1) as f64
}

/// The smoothers a prior is compared with: the encoder's candidates and two stiffer ones.
fn baselines() -> Vec<Smoothing> {
    let stiffer = [Smoothing { order: 2, stiffness: 1000.0 }, Smoothing { order: 1, stiffness: 3.0 }];
    CANDIDATES.into_iter().chain(stiffer).collect()
}

/// Features of takes.
pub fn features_of(prior: &MotionPrior, takes: &[Take]) -> Vec<Vec<f32>> {
    takes.iter().map(|take| rows(&prior.chart().features_of_take(&take.rotations))).collect()
}

/// Takes cut into whole clips of `length` frames.
pub fn clips_of(takes: &[Vec<f32>], length: usize) -> Vec<Vec<f32>> {
    takes.iter().flat_map(|take| take.chunks_exact(length * N_FEATURES)).map(<[f32]>::to_vec).collect()
}

/// A take of `length` frames: the given one forwards and backwards repeatedly.
pub fn prolonged(take: &[f32], length: usize) -> Vec<f32> {
    let n = take.len() / N_FEATURES;
    let period = (2 * n).saturating_sub(2).max(1);
    let row = |t: usize| if t % period < n { t % period } else { period - t % period };
    (0..length).flat_map(|t| take[row(t) * N_FEATURES..][..N_FEATURES].iter().copied()).collect()
}

/// Reconstruction by the posterior's mean.
pub fn reconstruction(prior: &MotionPrior, takes: &[Vec<f32>]) -> JointErrors {
    let observed: Vec<Observed> = takes.iter().map(|take| Observed::complete(take.clone())).collect();
    let all = |_: usize, _: usize, _: usize| true;
    joint_errors(prior, &through(prior, &observed), takes, &all)
}

fn through(prior: &MotionPrior, observed: &[Observed]) -> Vec<Vec<f32>> {
    prior.decode(&prior.encode(observed).into_iter().map(|posterior| posterior.mean).collect::<Vec<_>>())
}

/// Rows 1b and 3: `corruption` is applied to every clip; `counts(clip, frame, joint)` chooses what is measured.
pub fn task(
    prior: &MotionPrior,
    clips: &[Vec<f32>],
    corruption: &dyn Fn(usize) -> Corruption,
    counts: &dyn Fn(usize, usize, usize) -> bool,
) -> TaskErrors {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let observed: Vec<Observed> =
        clips.iter().enumerate().map(|(i, c)| corrupted(c, corruption(i), &mut rng)).collect();
    let basis = prior.basis();
    let error = |paths: &[Vec<f32>]| joint_errors(prior, paths, clips, counts);
    let each = |path: &dyn Fn(&Observed) -> Vec<f32>| error(&observed.iter().map(path).collect::<Vec<_>>()).mean_mm;
    TaskErrors {
        prior: error(&through(prior, &observed)),
        smoothings_mm: baselines().into_iter().map(|s| (s, each(&|o| smoothed(o, s, &basis.mean)))).collect(),
        autoregression_mm: each(&|o| autoregressed(o, &basis.autoregression, &basis.mean)),
    }
}

/// Completion of a gap of 15 frames in which nothing is seen, in the middle of every clip.
pub fn gap_task(prior: &MotionPrior, clips: &[Vec<f32>]) -> TaskErrors {
    let start = |clip: usize| (clips[clip].len() / N_FEATURES - 15) / 2;
    let counts = |clip: usize, t: usize, _: usize| (start(clip)..start(clip) + 15).contains(&t);
    task(prior, clips, &|clip| Corruption::Gap { start: start(clip), n_frames: 15 }, &counts)
}

/// Completion of one limb, unseen for 60 frames; measured on the joints that the limb moves.
pub fn limb_task(prior: &MotionPrior, clips: &[Vec<f32>]) -> TaskErrors {
    let start = |clip: usize| (clips[clip].len() / N_FEATURES - 60) / 2;
    let limb = |clip: usize| clip % LIMBS.len();
    let counts = |clip: usize, t: usize, joint: usize| {
        let moved = std::iter::successors(PARENTS[joint], |&j| PARENTS[j]).any(|j| LIMBS[limb(clip)].contains(&j));
        moved && (start(clip)..start(clip) + 60).contains(&t)
    };
    task(prior, clips, &|clip| Corruption::Limb { limb: limb(clip), start: start(clip), n_frames: 60 }, &counts)
}

/// Denoising: 10 degrees on half of the joints, the same in every frame (`steady`) or drawn in each; a fifth of the joints
/// unseen for ten frames.
pub fn noise_task(prior: &MotionPrior, clips: &[Vec<f32>], steady: bool) -> TaskErrors {
    debug_assert_eq!(HOLE_FRAMES, 10);
    let corruption = Corruption::Noise { sd: 10.0_f64.to_radians(), share: 0.5, steady };
    task(prior, clips, &|_| corruption, &|_, _, _| true)
}

/// Statistics of the codes of takes against N(0, I).
pub fn latent_statistics(prior: &MotionPrior, takes: &[Vec<f32>]) -> LatentStatistics {
    const D: usize = super::basis::LATENT_DIM;
    let observed: Vec<Observed> = takes.iter().map(|take| Observed::complete(take.clone())).collect();
    let (mut squares, mut kl, mut n, mut bend, mut n_bend) = ([0.0_f64; D], 0.0, 0_usize, 0.0, 0_usize);
    for posterior in prior.encode(&observed) {
        for (i, (m, v)) in posterior.mean.iter().zip(&posterior.log_variance).enumerate() {
            let (m, v) = (f64::from(*m), f64::from(*v));
            squares[i % D] += m * m + v.exp();
            kl += 0.5 * (m * m + v.exp() - v - 1.0);
            n += 1;
        }
        for window in posterior.mean.windows(2 * D + 1) {
            bend += f64::from(window[2 * D] - 2.0 * window[D] + window[0]).powi(2);
            n_bend += 1;
        }
    }
    let n_frames = (n / D).max(1) as f64;
    let squares = squares.map(|s| s / n_frames);
    LatentStatistics {
        mean_square: squares.iter().sum::<f64>() / D as f64,
        min_square: squares.iter().copied().fold(f64::INFINITY, f64::min),
        max_square: squares.iter().copied().fold(0.0, f64::max),
        kl: kl / n.max(1) as f64,
        acceleration: (bend / n_bend.max(1) as f64).sqrt(),
    }
}

/// Largest and mean distance between joints at common times of takes reconstructed at 30 Hz and at `fps`, mm. The take at
/// `fps` is the same motion, resampled by the cubic of [`super::interpolation`].
pub fn rate_difference_mm(prior: &MotionPrior, takes: &[Take], fps: f64) -> [f64; 2] {
    let bones = Bones::of_default_body();
    // Every 0.2 s: common to 25, 30 and 60 Hz.
    let (step_30, step) = (6, (fps / 5.0).round() as usize);
    let (mut worst, mut sum, mut n) = (0.0_f64, 0.0, 0_usize);
    for take in takes {
        let n_frames = resampled_len(take.rotations.len(), GRID_FPS, fps);
        let other = resampled(&take.rotations, GRID_FPS, fps, n_frames);
        let at_30 = prior.reconstructed(&take.rotations, None, GRID_FPS);
        let at_fps = prior.reconstructed(&other, None, fps);
        for (a, b) in at_30.iter().step_by(step_30).zip(at_fps.iter().step_by(step)) {
            let (a, b) = (bones.posed(a).joints, bones.posed(b).joints);
            for j in 1..N_JOINTS {
                worst = worst.max((a[j] - b[j]).norm());
                sum += (a[j] - b[j]).norm();
                n += 1;
            }
        }
    }
    [1e3 * worst, 1e3 * sum / n.max(1) as f64]
}

/// A code from N(0, I), smoothed in time, `[T, 32]`.
pub fn random_code(n_frames: usize, seed: u64) -> Vec<f32> {
    smooth_code(n_frames, &mut ChaCha8Rng::seed_from_u64(seed))
}

/// Statistics of `n` motions of 60 frames drawn from the prior.
pub fn sample_statistics(prior: &MotionPrior, n: usize, seed: u64) -> SampleStatistics {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let codes: Vec<Vec<f32>> = (0..n).map(|_| smooth_code(60, &mut rng)).collect();
    let (bones, ranges, contact) = (Bones::of_default_body(), joint_ranges(), SelfContact::of_default_body());
    let (mut inside, mut nearly, mut penetrating, mut heights) = (0_usize, 0_usize, 0_usize, Vec::new());
    for local in prior.decode(&codes).iter().flat_map(|f| prior.rotations(f)) {
        let past = |j: usize| excess(&rotation::log(&local[j]), &ranges[j]).amax();
        let worst = (1..N_JOINTS).map(past).fold(0.0, f64::max);
        inside += usize::from(worst == 0.0);
        nearly += usize::from(worst < 10.0_f64.to_radians());
        penetrating += usize::from(contact.depth(&local) > DEEP);
        let joints = bones.posed(&local).joints;
        heights.push(joints[10].y.min(joints[11].y));
    }
    let n_frames = heights.len().max(1) as f64;
    let mean = heights.iter().sum::<f64>() / n_frames;
    let share = |count: usize| count as f64 / n_frames;
    SampleStatistics {
        within_limits: share(inside),
        within_limits_and_10_deg: share(nearly),
        penetrating: share(penetrating),
        foot_height_spread: (heights.iter().map(|h| (h - mean).powi(2)).sum::<f64>() / n_frames).sqrt(),
    }
}

fn joint_errors(
    prior: &MotionPrior,
    found: &[Vec<f32>],
    truth: &[Vec<f32>],
    counts: &dyn Fn(usize, usize, usize) -> bool,
) -> JointErrors {
    let bones = Bones::of_default_body();
    let joints = |take: &Vec<f32>| joints_of(prior.chart(), &bones, take);
    let mut errors = Vec::new();
    let mut accelerations = [0.0; 2];
    for (clip, (found, truth)) in found.iter().zip(truth).enumerate() {
        let both = [joints(found), joints(truth)];
        for t in 0..both[1].len() {
            let counted = (1..N_JOINTS).filter(|j| counts(clip, t, *j));
            errors.extend(counted.map(|j| 1e3 * (both[0][t][j] - both[1][t][j]).norm()));
        }
        for (sum, joints) in accelerations.iter_mut().zip(&both) {
            let bend = |w: &[JointPositions], j: usize| (w[0][j] - w[1][j] * 2.0 + w[2][j]).norm();
            *sum += joints.windows(3).map(|w| (1..N_JOINTS).map(|j| bend(w, j)).sum::<f64>()).sum::<f64>();
        }
    }
    errors.sort_by(f64::total_cmp);
    let n = errors.len();
    JointErrors {
        mean_mm: errors.iter().sum::<f64>() / n.max(1) as f64,
        p95_mm: errors.get(n * 95 / 100).copied().unwrap_or(0.0),
        acceleration_ratio: if accelerations[1] > 0.0 { accelerations[0] / accelerations[1] } else { 1.0 },
    }
}
