//! How far the covariances that a detector states decide.
//!
//! Detectors are overconfident, or state something that has little to do with their errors. Their covariances `C` are therefore
//! never taken as they are: a pixel of landmark l, whose scale is the person's size times the noise factor f of its confidence, has
//! an error of the covariance
//!
//! `(share_l scale x^a y^-c)^2 (C / sqrt|C|)^b`, `x = |C|^(1/4) / size / g_l`, `y = f / f_l`
//!
//! with the share that the session's own residuals show, and geometric means `g_l`, `f_l` over the landmark's pixels: sizes that are
//! off by a common factor change nothing. The exponents a of sizes, b of shapes, and `c <= a` of what the confidence no longer has
//! to say, are those from 0 to 1 under which the innovations of the first fit are likeliest. All at 0: covariances are ignored.

use super::camera_adjustment::settle;
use super::context::FitContext;
use super::joint_problem::Member;
use super::noise_measurement::{measured_noise, positions};
use super::observations::{ErrorShape, Observations, PixelObservation};
use super::person_fit::StartedMotion;
use super::terms::noise_process::PathNoise;
use super::terms::whitened_pixels::WhitenedPixels;
use crate::optim::robust::median;
use crate::progress::Canceled;

/// How far the stated covariances count, 0 (not at all) to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Exponents {
    /// Of the stated sizes: `a`.
    size: f64,
    /// Of the stated shapes: `b`.
    shape: f64,
    /// Of the confidence, which is taken back by this: `c`.
    confidence: f64,
}

/// What the session shows of the stated covariances.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StatedCovariances {
    exponents: Exponents,
    /// Standard deviation that the residuals show over the stated one; the median of the landmarks.
    scale: f64,
}

/// Means over a landmark's pixels with a stated covariance: of the logarithms of stated size over apparent size, and of the factor of
/// the confidence.
#[derive(Debug, Clone, Copy, Default)]
struct Means {
    log_ratio: f64,
    log_factor: f64,
    n: f64,
}

/// Values that are tried of an exponent, from 0 to 1; the maximum of the parabola through the best and its neighbours is taken.
const N_STEPS: usize = 4;

/// Rounds over the exponents: after the first, sizes and shapes are right to a tenth.
const N_ROUNDS: usize = 2;

/// Most frames of all persons on which the exponents are measured: errors of some hundred frames tell them to a few hundredths.
const MAX_FRAMES: usize = 500;

/// Fewest frames of one person.
const MIN_FRAMES: usize = 60;

/// Smallest exponent that counts: below, the stated covariances explain nothing that chance would not.
const MIN_EXPONENT: f64 = 0.05;

/// Measures what the stated covariances are worth on the first fits, and gives all pixels their sizes and shapes. `None` where none
/// are stated, and in sessions of a single camera, whose residuals do not show its errors; pixels then stay as they are.
pub(super) fn weigh_stated_covariances(
    context: &FitContext,
    started: &mut [Option<(Observations, StartedMotion)>],
) -> Result<Option<StatedCovariances>, Canceled> {
    let n_cameras = started.iter().flatten().next().map_or(0, |(observations, _)| observations.cameras.len());
    let pixels = || started.iter().flatten().flat_map(|(observations, _)| observations.pixels.iter().flatten());
    if n_cameras < 2 || !pixels().any(|pixel| pixel.error.stated().is_some()) {
        return Ok(None);
    }
    let means = means(context.model.landmarks.len(), pixels());
    let n_frames = (MAX_FRAMES / started.iter().flatten().count()).max(MIN_FRAMES);
    let member = |(observations, fit): &(Observations, StartedMotion)| {
        Member::of(observations, fit, observations.most_seen(fit.window.clone(), n_frames), 1)
    };
    let mut members: Vec<Member> = started.iter().flatten().map(member).collect();
    // The first fits took every few frames.
    settle(context, &mut members)?;
    let exponents = likeliest_exponents(|exponents| likelihood(context, &weighed(&members, &exponents, &means)).0);
    let noise = likelihood(context, &weighed(&members, &exponents, &means)).1;
    for (observations, _) in started.iter_mut().flatten() {
        apply(observations, &exponents, &means);
    }
    Ok(Some(StatedCovariances { exponents, scale: scale(&noise, &means) }))
}

/// One exponent after the other, in rounds.
fn likeliest_exponents(log_likelihood: impl Fn(Exponents) -> f64) -> Exponents {
    let mut best = Exponents::default();
    for _ in 0..N_ROUNDS {
        best.shape = likeliest(1.0, |shape| log_likelihood(Exponents { shape, ..best }));
        best.size =
            likeliest(1.0, |size| log_likelihood(Exponents { size, confidence: best.confidence.min(size), ..best }));
        best.confidence = likeliest(best.size, |confidence| log_likelihood(Exponents { confidence, ..best }));
    }
    best
}

/// The value from 0 to `largest` at which `log_likelihood` is largest.
fn likeliest(largest: f64, log_likelihood: impl Fn(f64) -> f64) -> f64 {
    if largest == 0.0 {
        return 0.0;
    }
    let at = |step: usize| largest * step as f64 / N_STEPS as f64;
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

fn weighed(members: &[Member], exponents: &Exponents, means: &[Means]) -> Vec<Member> {
    let weighed = |member: &Member| {
        let mut member = member.clone();
        apply(&mut member.observations, exponents, means);
        member
    };
    members.iter().map(weighed).collect()
}

/// Logarithms of the stated size over the apparent one, and of the factor of the confidence.
fn logarithms(pixel: &PixelObservation) -> Option<[f64; 2]> {
    let stated = pixel.error.stated()?;
    Some([(stated.covariance.size() / stated.size_px).ln(), (pixel.scale_px / stated.size_px).ln()])
}

fn means<'a>(n_landmarks: usize, pixels: impl Iterator<Item = &'a PixelObservation>) -> Vec<Means> {
    let mut sums = vec![Means::default(); n_landmarks];
    for pixel in pixels {
        if let Some([log_ratio, log_factor]) = logarithms(pixel) {
            let sum = &mut sums[pixel.landmark];
            sum.log_ratio += log_ratio;
            sum.log_factor += log_factor;
            sum.n += 1.0;
        }
    }
    let mean = |sum: Means| {
        let n = sum.n.max(1.0);
        Means { log_ratio: sum.log_ratio / n, log_factor: sum.log_factor / n, n: sum.n }
    };
    sums.into_iter().map(mean).collect()
}

/// Median over the landmarks of the measured over the stated standard deviation, by their mean logarithms.
fn scale(noise: &PathNoise, means: &[Means]) -> f64 {
    let stated = noise.shares.iter().zip(means).filter(|(_, means)| means.n > 0.0);
    let ratio = |(share, means): (&f64, &Means)| share * (means.log_factor - means.log_ratio).exp();
    median(&mut stated.map(ratio).collect::<Vec<_>>()).unwrap_or(1.0)
}

fn apply(observations: &mut Observations, exponents: &Exponents, means: &[Means]) {
    for pixel in observations.pixels.iter_mut().flatten() {
        let (Some(stated), Some([log_ratio, log_factor])) = (pixel.error.stated().copied(), logarithms(pixel)) else {
            continue;
        };
        let means = &means[pixel.landmark];
        let by_size = exponents.size * (log_ratio - means.log_ratio);
        pixel.scale_px *= (by_size - exponents.confidence * (log_factor - means.log_factor)).exp();
        pixel.error = match exponents.shape > 0.0 {
            true => ErrorShape::Whitened(stated.covariance.whitening(exponents.shape)),
            false => ErrorShape::Round,
        };
    }
}

impl StatedCovariances {
    /// For the report.
    pub(super) fn metrics(&self) -> [(String, f64); 3] {
        let Exponents { size, shape, .. } = self.exponents;
        [
            ("covariance_size_exponent".to_owned(), size),
            ("covariance_shape_exponent".to_owned(), shape),
            ("covariance_scale".to_owned(), self.scale),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likeliest_exponent_is_that_of_the_parabola() {
        for wanted in [0.3, 0.55, 0.8] {
            let found = likeliest(1.0, |a| -40.0 * (a - wanted) * (a - wanted));
            assert!((found - wanted).abs() < 1e-9, "{found}");
        }
        assert_eq!(likeliest(1.0, |a| -a), 0.0);
        assert_eq!(likeliest(0.6, |a| a), 0.6);
        assert_eq!(likeliest(1.0, |a| -(a - 0.02) * (a - 0.02)), 0.0, "what chance explains is ignored");
        assert_eq!(likeliest(1.0, |_| 0.0), 0.0);
    }

    #[test]
    fn confidence_gives_way_to_stated_sizes_alone() {
        let cost = |e: Exponents, [size, shape, confidence]: [f64; 3]| {
            -(e.size - size).powi(2) - (e.shape - shape).powi(2) - (e.confidence - confidence).powi(2)
        };
        let found = likeliest_exponents(|e| cost(e, [0.8, 0.5, 0.4]));
        assert!((found.size - 0.8).abs() < 1e-9 && (found.shape - 0.5).abs() < 1e-9, "{found:?}");
        assert!((found.confidence - 0.4).abs() < 1e-9, "{found:?}");
        let ignored = likeliest_exponents(|e| cost(e, [0.0, 0.0, 0.9]));
        assert_eq!(ignored, Exponents::default());
    }
}
