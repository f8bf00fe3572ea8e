//! Delays, distortions and focal lengths that an adjustment of all cameras finds.

use super::distortion::other_distortions;
use super::free_adjustment::FreeAdjustment;
use super::lenses::{EXCHANGE, lies_within, misplaced_lenses};
use super::solved::Solved;
use super::start_times::time_offset;
use crate::optim::robust::median;
use crate::pipeline::calibration::Adjusted;
use crate::pipeline::camera_clock::rate_of_drift;
use crate::pipeline::config::{IntrinsicsMode, Sync};
use crate::pipeline::focal_spread::{FoundFactors, MIN_LOG_EVIDENCE};
use crate::pipeline::stages::bundle_adjustment::input::AdjustmentConfig;
use crate::pipeline::stages::recording_check::parameters::{
    Delay, WrongLenses, delays, drifts, likeliest_exchange, smaller_images, wrong_lenses,
};
use crate::progress::{Canceled, Progress};
use crate::session::{Suspicion, SuspicionCode as Code};

/// Images are smaller than stated where keypoints stay within this share of width and height: people walk through more of an image,
/// and the next smaller format has two thirds.
const SHOWN_BY_SMALLER: f64 = 0.72;
/// Factor on a focal length below which it belongs to smaller images: halfway, in logarithms, to the next smaller usual size.
const OF_SMALLER: f64 = 0.866;

/// Delays, distortions and focal lengths against those given.
pub(super) fn other_parameters(
    solved: &Solved,
    found: &mut Vec<Suspicion>,
    progress: &Progress,
) -> Result<(), Canceled> {
    let options = solved.given.options;
    let mut steps = progress.steps([1.0, 1.0]);
    let resections = solved.resections();
    let step = steps.begin("testing calibrations of other images");
    let is_fixed = options.intrinsics_of(solved.session()) == IntrinsicsMode::Fixed;
    let misplaced = if is_fixed { misplaced_lenses(solved, &resections, &step)? } else { None };
    let progress = &steps.begin("testing delays and lenses");
    let free = FreeAdjustment::from_resections(solved, &resections, None, progress)?;
    if let Some(misplaced) = misplaced {
        // Where all lenses distort otherwise than given, some suit other cameras better.
        let of_all = other_distortions(solved, &free, progress)?.into_iter().find(|found| found.cameras.is_empty());
        found.push(of_all.unwrap_or(misplaced));
        return Ok(());
    }
    let adjusted = &free.adjusted;
    let origins: Vec<f64> = resections.iter().map(|lens| lens.map_or(0.0, |lens| lens.factor.ln())).collect();
    for (view, camera) in adjusted.cameras.iter().enumerate() {
        let sigma = camera.uncertainty.and_then(|u| u.sigma_delay);
        tracing::debug!(view, camera.delay, sigma, camera.focal_factor, "found by the check");
    }
    if options.sync == Sync::Given {
        let late = delays(adjusted).into_iter().filter(|delay| !solved.is_named(delay.view, &[]));
        found.extend(late.map(|delay| of_delay(solved, &delay)));
    }
    // Before focal lengths, which follow a distortion in the middle of the image.
    if found.is_empty() {
        found.extend(other_distortions(solved, &free, progress)?);
    }
    if found.is_empty() && is_fixed {
        found.extend(of_focal_factors(solved, adjusted, &origins));
    }
    Ok(())
}

fn of_delay(solved: &Solved, delay: &Delay) -> Suspicion {
    // A picture that was taken late has a frame number that is too low.
    let direction = if delay.frames > 0.0 { "low" } else { "high" };
    let evidence =
        format!("its frame numbers are {:.1} +- {:.1} frames too {direction}", delay.frames.abs(), delay.sigma);
    of_clock(solved, delay.view, evidence)
}

fn of_clock(solved: &Solved, view: usize, evidence: String) -> Suspicion {
    time_offset(solved.ids(&[view]), evidence)
}

/// Cameras whose clocks run at another rate than those of most others: delays at the end of the recording against those in its middle.
pub(super) fn drifting_clocks(solved: &Solved, progress: &Progress) -> Result<Vec<Delay>, Canceled> {
    let take = Some(solved.session().n_frames);
    let free = FreeAdjustment::from_resections(solved, &solved.resections(), take, progress)?;
    let drifts = drifts(&free.adjusted);
    tracing::debug!(?drifts, "drifts of clocks found by the check");
    Ok(drifts)
}

/// See [`drifting_clocks`].
pub(super) fn of_drift(solved: &Solved, &Delay { view, frames, sigma }: &Delay) -> Suspicion {
    // Frames that are taken later and later have too few numbers.
    let direction = if frames > 0.0 { "slow" } else { "fast" };
    let percent = 100.0 * rate_of_drift(frames.abs(), solved.session().n_frames);
    let evidence = format!(
        "its clock is {percent:.2} % {direction}: it drifts by {:.1} +- {:.1} frames over the recording",
        2.0 * frames.abs(),
        2.0 * sigma
    );
    of_clock(solved, view, evidence)
}

/// What the focal factors of an adjustment show, which began at those of logarithms `origins`.
fn of_focal_factors(solved: &Solved, adjusted: &Adjusted, origins: &[f64]) -> Option<Suspicion> {
    let estimate = adjusted.focal.as_ref()?;
    let prior_sigma = AdjustmentConfig::default().focal_sigma;
    let found = FoundFactors::of_adjustment(estimate, |view| origins[view], prior_sigma)?;
    let focal = |view: usize| solved.session().views[view].intrinsics.focal();
    if let Some(exchange) = likeliest_exchange(&found, &estimate.views, focal) {
        let evidence = "each has the focal length of the other".to_owned();
        return Some(Suspicion::new(Code::CamerasExchanged, solved.ids(&exchange.views), evidence, EXCHANGE));
    }
    let lenses = wrong_lenses(&found, &estimate.views)?;
    let resized = other_resolution(solved, &found, &estimate.views, &lenses);
    resized.or_else(|| of_lenses(solved, &lenses))
}

fn of_lenses(solved: &Solved, lenses: &WrongLenses) -> Option<Suspicion> {
    if lenses.log_evidence < MIN_LOG_EVIDENCE {
        return None;
    }
    let listed = lenses.factors.iter().map(|&(v, factor)| {
        let change = 100.0 * (factor - 1.0);
        format!("{} {change:+.0} %", solved.session().views[v].id)
    });
    let listed: Vec<String> = listed.collect();
    let evidence = format!("the people agree better between cameras with other focal lengths: {}", listed.join(", "));
    let views: Vec<usize> = lenses.factors.iter().map(|(v, _)| *v).collect();
    let cameras = if lenses.is_common { Vec::new() } else { solved.ids(&views) };
    let remedy = "check the matrix K, or let focal lengths be refined";
    let suggested_option = Some(r#"{"intrinsics": "refine_focal"}"#.to_owned());
    Some(Suspicion { suggested_option, ..Suspicion::new(Code::FocalLength, cameras, evidence, remedy) })
}

/// Cameras whose focal length and keypoints both belong to smaller images.
fn other_resolution(
    solved: &Solved,
    found: &FoundFactors,
    adjusted: &[usize],
    lenses: &WrongLenses,
) -> Option<Suspicion> {
    let is_smaller = |view: usize| lies_within(&solved.session().views[view], SHOWN_BY_SMALLER);
    let smaller = lenses.factors.iter().filter(|(view, factor)| *factor < OF_SMALLER && is_smaller(*view));
    let (views, mut factors): (Vec<usize>, Vec<f64>) = smaller.copied().unzip();
    let image_scale = smaller_images(found, adjusted, &views, median(&mut factors)?, lenses.log_evidence)?;
    let evidence = "the focal length is too long, and all keypoints lie in the upper left two thirds of the image: both suit \
                    smaller images";
    let remedy = "give K and the size of the images in which people were detected";
    let suspicion = Suspicion::new(Code::Resolution, solved.ids(&views), evidence, remedy);
    Some(Suspicion { image_scale: Some(image_scale), ..suspicion })
}
