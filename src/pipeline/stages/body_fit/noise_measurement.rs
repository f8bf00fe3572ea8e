//! The detector's errors over time, measured on the residuals of a fit.

use super::context::FitContext;
use super::joint_problem::Member;
use super::terms::noise_process::{LagSums, NoiseProcess, PathNoise};
use super::terms::whitened_pixels::{Positions, Run, WhitenedPixels};
use crate::body::BodyModel;
use crate::body::bone_offsets::with_bones;
use crate::body::kinematics::{landmark_position, posed};
use crate::optim::robust::{MEDIAN_LENGTH_IN_PLANE, median};
use rayon::prelude::*;

/// Number of residuals of all landmarks that count as much as one landmark's own for its process. Slow errors change every thirty
/// frames or so, so that 1,000 residuals know an autocorrelation of 0.85 to 0.03, about as much as landmarks differ by.
const POOLED_PROCESS: f64 = 1000.0;

/// The same for its standard deviation: four seconds of one camera, in which a slow error has changed once.
const POOLED_SIGMA: f64 = 100.0;

/// Least standard deviation of an innovation, as a share of the person's apparent size: a quarter of the best detector's error
/// (`pixel_share_bounds`), 2 mm on an adult. No body model fits a person any closer, and pixels without errors would otherwise take each
/// start for an outlier of thousands of standard deviations.
const LEAST_SHARE: f64 = 0.001;

/// Measures the processes of all landmarks on the residuals of `members`.
///
/// The variance of the innovations is measured, too: it decides the weights, and real errors have heavier tails than their
/// autocorrelation says.
pub(super) fn measured_noise(context: &FitContext, members: &[Member]) -> PathNoise {
    let model = context.model;
    let n_landmarks = model.landmarks.len();
    let paths = |noise: &PathNoise, member: &Member| {
        let paths = WhitenedPixels::new(&member.observations, noise, context.config.robust_scale);
        let positions = positions(model, member, &paths.landmarks);
        (paths, positions)
    };
    let unit = PathNoise::white(n_landmarks, 1.0);
    let residuals_of = |member: &Member| {
        let (paths, positions) = paths(&unit, member);
        paths.residuals(&member.observations.cameras, &positions)
    };
    let residuals: Vec<(usize, Run)> = members.par_iter().flat_map_iter(residuals_of).collect();
    let lengths = residuals.iter().map(|(landmark, run)| (*landmark, run.iter().map(|(_, r)| r.norm()).collect()));
    let levels = sigmas(n_landmarks, lengths);

    let mut sums = vec![LagSums::new(context.frame_interval); n_landmarks];
    let mut all = LagSums::new(context.frame_interval);
    for (landmark, mut run) in residuals {
        run.iter_mut().for_each(|(_, residual)| *residual /= levels[landmark]);
        sums[landmark].add(&run);
        all.add(&run);
    }
    let processes = sums.iter().map(|sums| NoiseProcess::of(&sums.pooled(&all, POOLED_PROCESS))).collect();
    let noise = PathNoise { processes, shares: levels, ..unit };

    let innovations_of = |member: &Member| {
        let (paths, positions) = paths(&noise, member);
        paths.innovations(&member.observations.cameras, &positions)
    };
    let innovations: Vec<(usize, Vec<f64>)> = members.par_iter().flat_map_iter(innovations_of).collect();
    let factors = sigmas(n_landmarks, innovations.into_iter());
    let shares = noise.shares.iter().zip(factors).map(|(share, factor)| (share * factor).max(LEAST_SHARE)).collect();
    PathNoise { shares, ..noise }
}

/// Positions of `landmarks` in the frames of a member, `[frame][landmark]`.
pub(super) fn positions(model: &BodyModel, member: &Member, landmarks: &[usize]) -> Positions {
    let own = with_bones(model, &member.bones);
    let body = own.shaped(&member.state.betas);
    let at = |pose| {
        let skeleton = posed(&body, pose);
        landmarks.iter().map(|&landmark| landmark_position(&own, &body, &skeleton, landmark)).collect()
    };
    member.state.poses.iter().map(at).collect()
}

/// Standard deviations per axis by landmark, from lengths in the plane; drawn towards that of all where there are few.
fn sigmas(n_landmarks: usize, lengths: impl Iterator<Item = (usize, Vec<f64>)>) -> Vec<f64> {
    let mut by_landmark = vec![Vec::new(); n_landmarks];
    lengths.for_each(|(landmark, lengths)| by_landmark[landmark].extend(lengths));
    let sigma =
        |lengths: &mut [f64]| median(lengths).map(|median| (median / MEDIAN_LENGTH_IN_PLANE).max(f64::MIN_POSITIVE));
    let all = sigma(&mut by_landmark.concat()).unwrap_or(1.0);
    let pooled = |mut lengths: Vec<f64>| {
        let n = lengths.len() as f64;
        let own = sigma(&mut lengths).unwrap_or(all);
        ((n * own.ln() + POOLED_SIGMA * all.ln()) / (n + POOLED_SIGMA)).exp()
    };
    by_landmark.into_iter().map(pooled).collect()
}
