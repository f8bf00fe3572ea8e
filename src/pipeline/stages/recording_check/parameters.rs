//! Delays and focal lengths that an adjustment of all cameras finds: which cameras are not as given.

use crate::optim::robust::median;
use crate::pipeline::calibration::{Adjusted, AdjustedCamera};
use crate::pipeline::focal_spread::{FocalSpread, FoundFactors, MIN_LOG_EVIDENCE};
use nalgebra::DVector;

/// A delay counts from this size, frames: half a frame is the most that cameras without a common clock differ by when they are
/// started together, and it moves a hand by 20 mm.
const MIN_DELAY: f64 = 0.6;
/// Standard errors from which a delay is certain: a constant error of the detector on moving limbs is in none of them.
const CERTAIN: f64 = 5.0;

/// A focal length counts from this difference: refocusing changes it by 1 %, and detectors' constant errors look like 2 %.
const MIN_FOCAL: f64 = 0.05;
/// Logarithm of the likelihood ratio from which focal lengths may be other than given.
const HINT_LOG_EVIDENCE: f64 = 2.0;
/// Two lenses whose focal lengths differ by less need no exchange: refocusing changes them by as much.
const MIN_DIFFERENCE: f64 = 0.01;
/// Logarithm of the likelihood ratio from which two calibrations are exchanged, or belong to smaller images, 150 to 1: it is one of few
/// possible mistakes.
const MIN_LOG_EVIDENCE_OF_MISTAKE: f64 = 5.0;

/// Usual sizes of images over those of their calibration: 1080 lines of 2160 or 1620, 720 of 1080, 1080 of 1440, 480 of 1080.
pub const SMALLER: [f64; 4] = [0.5, 2.0 / 3.0, 0.75, 4.0 / 9.0];
/// Largest difference of logarithms between the factor on a focal length and the size of the images that it belongs to: less than
/// half of the smallest between two usual sizes.
const SAME_SIZE: f64 = 0.055;

/// A camera whose frames are late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// Index of the view.
    pub view: usize,
    /// Frames; negative where they are early.
    pub frames: f64,
    /// Standard error.
    pub sigma: f64,
}

/// Cameras whose frames are late or early against most others.
pub fn delays(adjusted: &Adjusted) -> Vec<Delay> {
    against_most(adjusted, |camera| Some([camera.delay, camera.uncertainty?.sigma_delay?]))
}

/// Cameras whose frames become later, or earlier, than those of most others: the delays at the end of the take against those in its
/// middle.
pub fn drifts(adjusted: &Adjusted) -> Vec<Delay> {
    against_most(adjusted, |camera| Some([camera.drift, camera.uncertainty?.sigma_drift?]))
}

/// Cameras whose value differs from most others'; `of`: it and its standard error.
fn against_most(adjusted: &Adjusted, of: impl Fn(&AdjustedCamera) -> Option<[f64; 2]>) -> Vec<Delay> {
    let moved = adjusted.cameras.iter().enumerate().filter(|(_, camera)| camera.is_observed);
    let moved: Vec<(usize, [f64; 2])> = moved.filter_map(|(v, camera)| Some((v, of(camera)?))).collect();
    let Some(usual) = median(&mut moved.iter().map(|(_, [value, _])| *value).collect::<Vec<_>>()) else {
        return Vec::new();
    };
    // The first camera is the reference and has no error of its own; those of the others are against it.
    let mut sigmas: Vec<f64> = moved.iter().map(|(_, [_, sigma])| *sigma).filter(|sigma| *sigma > 0.0).collect();
    let sigma_of_first = median(&mut sigmas).unwrap_or(1.0);
    let delay = |&(view, [value, sigma]): &(usize, [f64; 2])| Delay {
        view,
        frames: value - usual,
        sigma: if sigma > 0.0 { sigma } else { sigma_of_first },
    };
    let found = moved.iter().map(delay);
    found.filter(|d| d.frames.abs() > MIN_DELAY && d.frames.abs() > CERTAIN * d.sigma).collect()
}

/// Focal lengths that are not as given.
#[derive(Debug, Clone, PartialEq)]
pub struct WrongLenses {
    /// Views and the factors on their given focal lengths.
    pub factors: Vec<(usize, f64)>,
    /// Whether it is most cameras.
    pub is_common: bool,
    /// Logarithm of the likelihood ratio.
    pub log_evidence: f64,
}

/// Two cameras with the focal length of each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchange {
    /// Their views.
    pub views: [usize; 2],
    /// Logarithm of the likelihood ratio to lenses as given.
    pub log_evidence: f64,
}

/// The likeliest exchange of two calibrations with different focal lengths; `None` where lenses as given, or with errors of any size,
/// are likelier.
///
/// `found`: what an adjustment shows of the focal factors of `views`; `focal`: the given focal length of a view.
pub fn likeliest_exchange(found: &FoundFactors, views: &[usize], focal: impl Fn(usize) -> f64) -> Option<Exchange> {
    let pairs = (0..views.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    let exchange = |(a, b): (usize, usize)| {
        let mut log_factors = DVector::zeros(views.len());
        log_factors[a] = (focal(views[b]) / focal(views[a])).ln();
        log_factors[b] = -log_factors[a];
        (log_factors[a].abs() > MIN_DIFFERENCE)
            .then(|| Exchange { views: [views[a], views[b]], log_evidence: found.log_evidence_of(&log_factors) })
    };
    let likeliest = pairs.filter_map(exchange).max_by(|x, y| x.log_evidence.total_cmp(&y.log_evidence))?;
    let of_errors = FocalSpread::likeliest(found).1;
    tracing::debug!(?likeliest, of_errors, "exchanged calibrations");
    (likeliest.log_evidence > MIN_LOG_EVIDENCE_OF_MISTAKE.max(of_errors)).then_some(likeliest)
}

/// The size of smaller images, over that of the calibration, to which the lenses of `smaller` belong by their common `factor`; `None`
/// where it is not a usual size, or where lenses as given, or with errors of any size, are likelier.
///
/// `found`: what an adjustment shows of the focal factors of `views`; `of_errors`: logarithm of the likelihood of lenses with
/// errors of any size over that of the given ones.
pub fn smaller_images(
    found: &FoundFactors,
    views: &[usize],
    smaller: &[usize],
    factor: f64,
    of_errors: f64,
) -> Option<f64> {
    let size = SMALLER.into_iter().find(|size| (size / factor).ln().abs() < SAME_SIZE)?;
    let log_factor = |view: &usize| if smaller.contains(view) { size.ln() } else { 0.0 };
    let log_evidence = found.log_evidence_of(&DVector::from_iterator(views.len(), views.iter().map(log_factor)));
    tracing::debug!(?smaller, size, log_evidence, of_errors, "lenses of smaller images");
    (log_evidence > MIN_LOG_EVIDENCE_OF_MISTAKE.max(of_errors)).then_some(size)
}

/// The focal lengths as an adjustment of `views` under the given ones finds them; `None` where nothing speaks against the given ones.
pub fn wrong_lenses(found: &FoundFactors, views: &[usize]) -> Option<WrongLenses> {
    let (spread, log_evidence) = FocalSpread::likeliest(found);
    tracing::debug!(?spread, log_evidence, "focal lengths found by the check");
    if log_evidence < HINT_LOG_EVIDENCE {
        return None;
    }
    // Where the evidence is a hint, other evidence must confirm it, and no factor is certain by itself.
    let is_hint = log_evidence < MIN_LOG_EVIDENCE;
    let (log_factors, covariance) = found.under(if is_hint { FocalSpread::WIDE } else { spread })?;
    let is_wrong = |k: &usize| {
        let size = log_factors[*k].abs();
        size > MIN_FOCAL && (is_hint || size > 2.0 * covariance[(*k, *k)].max(0.0).sqrt())
    };
    let factors: Vec<(usize, f64)> =
        (0..views.len()).filter(is_wrong).map(|k| (views[k], log_factors[k].exp())).collect();
    (!factors.is_empty()).then(|| WrongLenses { is_common: 2 * factors.len() > views.len(), factors, log_evidence })
}
