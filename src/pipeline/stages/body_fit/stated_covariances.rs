//! How far the covariances that a detector states decide.
//!
//! Detectors are overconfident, or state something that has little to do with their errors. Their covariances `C` are therefore
//! never taken as they are: a pixel's error has the covariance
//!
//! `share_l^2 (scale^2 I)^(1 - a) (C / g_l^2)^a`
//!
//! with the size `share_l` that the session's own residuals show of landmark l, the scale of a pixel without a stated covariance,
//! `g_l` the mean (of logarithms) of the stated sizes over those scales, so that sizes far off by a common factor change nothing,
//! and `0 <= a <= 1` the exponent under which the innovations of the first fit are likeliest. 0 is a covariance that is ignored.

use super::context::FitContext;
use super::joint_problem::Member;
use super::noise_measurement::{measured_noise, positions};
use super::observations::{Observations, PixelObservation};
use super::person_fit::StartedMotion;
use super::terms::noise_process::PathNoise;
use super::terms::whitened_pixels::WhitenedPixels;
use crate::optim::robust::median;

/// What the session shows of the stated covariances.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StatedCovariances {
    /// Exponent `a`, 0 to 1.
    pub exponent: f64,
    /// Standard deviation that the residuals show over the stated one; the median of the landmarks.
    pub scale: f64,
    /// Mean logarithm of stated sizes over scales, by landmark: `ln g_l`.
    log_ratios: Vec<f64>,
}

/// Exponents that are tried; the maximum of the parabola through the best and its neighbours is taken.
const N_STEPS: usize = 8;

/// Most frames of all persons on which the exponent is measured: errors of a thousand frames tell it to a hundredth.
const MAX_FRAMES: usize = 1200;

/// Fewest frames of one person.
const MIN_FRAMES: usize = 60;

/// Smallest exponent that counts: below, the stated covariances explain nothing that chance would not.
const MIN_EXPONENT: f64 = 0.05;

/// Measures what the stated covariances are worth on the first fits, and gives all pixels their sizes and shapes. `None` where none
/// are stated, and in sessions of a single camera, whose residuals do not show its errors; pixels then stay as they are.
pub(super) fn weigh_stated_covariances(
    context: &FitContext,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Option<StatedCovariances> {
    let n_cameras = started.iter().flatten().next().map_or(0, |(observations, _)| observations.cameras.len());
    let pixels = || started.iter().flatten().flat_map(|(observations, _)| observations.pixels.iter().flatten());
    if n_cameras < 2 || !pixels().any(|pixel| pixel.stated.is_some()) {
        return None;
    }
    let log_ratios = log_ratios(context.model.landmarks.len(), pixels());
    let n_frames = (MAX_FRAMES / started.iter().flatten().count()).max(MIN_FRAMES);
    let member = |(observations, fit): &(Observations, StartedMotion)| {
        Member::of(observations, fit, observations.most_seen(fit.window.clone(), n_frames), 1)
    };
    let members: Vec<Member> = started.iter().flatten().map(member).collect();
    let exponent = likeliest(|exponent| likelihood(context, &weighed(&members, exponent, &log_ratios)).0);
    let noise = likelihood(context, &weighed(&members, exponent, &log_ratios)).1;
    let stated = StatedCovariances { exponent, scale: scale(&noise, &log_ratios), log_ratios };
    for (observations, _) in started.iter_mut().flatten() {
        stated.apply(observations);
    }
    Some(stated)
}

/// The exponent at which `log_likelihood` is largest.
fn likeliest(log_likelihood: impl Fn(f64) -> f64) -> f64 {
    let at = |step: usize| step as f64 / N_STEPS as f64;
    let values: Vec<f64> = (0..=N_STEPS).map(|step| log_likelihood(at(step))).collect();
    let best = (0..=N_STEPS).max_by(|&a, &b| values[a].total_cmp(&values[b]).then(b.cmp(&a))).unwrap_or(0);
    let exponent = match best {
        0 | N_STEPS => at(best),
        _ => {
            let (before, after) = (values[best] - values[best - 1], values[best] - values[best + 1]);
            at(best) + 0.5 * at(1) * (before - after) / (before + after).max(f64::MIN_POSITIVE)
        }
    };
    if exponent < MIN_EXPONENT { 0.0 } else { exponent }
}

/// Logarithm of the likelihood of the members' innovations under the noise that is measured on them, and that noise.
fn likelihood(context: &FitContext, members: &[Member]) -> (f64, PathNoise) {
    let noise = measured_noise(context, members);
    let mut innovations = Default::default();
    for member in members {
        let paths = WhitenedPixels::new(&member.observations, &noise, context.config.robust_scale);
        let positions = positions(context.model, member, &paths.landmarks);
        paths.collect(&member.observations.cameras, &positions, &mut innovations);
    }
    (innovations.log_likelihood(), noise)
}

fn weighed(members: &[Member], exponent: f64, log_ratios: &[f64]) -> Vec<Member> {
    let weighed = |member: &Member| {
        let mut member = member.clone();
        apply(&mut member.observations, exponent, log_ratios);
        member
    };
    members.iter().map(weighed).collect()
}

fn log_ratio(pixel: &PixelObservation) -> Option<f64> {
    Some((pixel.stated?.size() / pixel.scale_px).ln())
}

fn log_ratios<'a>(n_landmarks: usize, pixels: impl Iterator<Item = &'a PixelObservation>) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); n_landmarks];
    for pixel in pixels {
        if let Some(ratio) = log_ratio(pixel) {
            let (sum, n) = &mut sums[pixel.landmark];
            (*sum, *n) = (*sum + ratio, *n + 1.0);
        }
    }
    sums.into_iter().map(|(sum, n)| if n > 0.0 { sum / n } else { 0.0 }).collect()
}

/// Median over the landmarks of the measured over the stated standard deviation; of two sizes of a pixel, the mean logarithms are
/// compared.
fn scale(noise: &PathNoise, log_ratios: &[f64]) -> f64 {
    let stated = noise.shares.iter().zip(log_ratios).filter(|(_, log_ratio)| **log_ratio != 0.0);
    median(&mut stated.map(|(share, log_ratio)| share / log_ratio.exp()).collect::<Vec<_>>()).unwrap_or(1.0)
}

fn apply(observations: &mut Observations, exponent: f64, log_ratios: &[f64]) {
    if exponent == 0.0 {
        return;
    }
    for pixel in observations.pixels.iter_mut().flatten() {
        let (Some(stated), Some(ratio)) = (pixel.stated, log_ratio(pixel)) else { continue };
        pixel.scale_px *= (exponent * (ratio - log_ratios[pixel.landmark])).exp();
        pixel.whitening = Some(stated.whitening(exponent));
    }
}

impl StatedCovariances {
    fn apply(&self, observations: &mut Observations) {
        apply(observations, self.exponent, &self.log_ratios);
    }

    /// For the report.
    pub(super) fn metrics(&self) -> [(String, f64); 2] {
        [("covariance_exponent".to_owned(), self.exponent), ("covariance_scale".to_owned(), self.scale)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likeliest_exponent_is_that_of_the_parabola() {
        for wanted in [0.3, 0.55, 0.9] {
            let found = likeliest(|a| -40.0 * (a - wanted) * (a - wanted));
            assert!((found - wanted).abs() < 1e-9, "{found}");
        }
        assert_eq!(likeliest(|a| -a), 0.0);
        assert_eq!(likeliest(|a| a), 1.0);
        assert_eq!(likeliest(|a| -(a - 0.02) * (a - 0.02)), 0.0, "what chance explains is ignored");
        assert_eq!(likeliest(|_| 0.0), 0.0);
    }
}
