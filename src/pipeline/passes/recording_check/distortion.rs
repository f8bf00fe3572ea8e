//! Lenses that distort the images otherwise than their calibration says: coefficients that were left out, or that were kept for images
//! which had been undistorted.
//!
//! Both leave straight lines bent: with the lens of an action camera (k1 of -0.3, 65 degrees) cameras are off by two to ten times their
//! standard deviations and bodies by half more, while every camera fits as well as the others. One coefficient per camera is enough to
//! notice it, and nearly enough to undo it.

use super::free_adjustment::FreeAdjustment;
use super::solved::Solved;
use crate::geometry::Distortion;
use crate::optim::robust::{GraduatedScale, median};
use crate::pipeline::calibration::{Adjusted, AdjustedCamera, CameraFreedom};
use crate::pipeline::focal_spread::OVERCOUNT;
use crate::pipeline::stages::bundle_adjustment::adjust;
use crate::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput};
use crate::progress::{Canceled, Progress};
use crate::session::{Suspicion, SuspicionCode as Code};
use std::ops::Range;

/// Change of a first radial coefficient from which it counts. At half a focal length from the middle of the image 0.1 moves a point by
/// 1.25 % of the focal length. Published lenses of real cameras are up to 0.065 off.
const MIN_CHANGE: f64 = 0.1;
/// Standard errors from which a change is certain that all lenses have in common; see [`certain_of_any`] for one of them. In 72 recordings
/// with right lenses the common change reaches 1.5, single ones 3.4; of 26 with wrong ones 23 are named, from 3.7 on.
const CERTAIN: f64 = 3.0;
/// Steps after which a radial coefficient is known to a fraction of its standard error.
const FIRST_STEPS: usize = 3;

/// Parts of the given first coefficient that images without distortion lack: the higher coefficients have an opposite sign.
const UNDISTORTED: Range<f64> = 0.5..1.3;

/// Settings that go on from an adjustment.
fn at_end() -> AdjustmentConfig {
    let defaults = AdjustmentConfig::default();
    AdjustmentConfig { scale: GraduatedScale { steps: 1, ..defaults.scale }, ..defaults }
}

/// How much the first radial coefficient of a camera's lens differs from the given one.
#[derive(Debug, Clone, Copy)]
struct Change {
    view: usize,
    value: f64,
    sigma: f64,
}

impl Change {
    /// Whether it is large, and certain from so many standard errors.
    fn counts(&self, certain: f64) -> bool {
        self.value.abs() > MIN_CHANGE.max(certain * self.sigma)
    }
}

/// Standard errors from which the change of any one of `n` lenses is as certain as [`CERTAIN`] makes the only one (Gaussian tails).
fn certain_of_any(n: usize) -> f64 {
    (CERTAIN.powi(2) + 2.0 * (n.max(1) as f64).ln()).sqrt()
}

/// Cameras whose images are distorted otherwise than given: all where most agree, or single ones.
pub(super) fn other_distortions(
    solved: &Solved,
    free: &FreeAdjustment,
    progress: &Progress,
) -> Result<Vec<Suspicion>, Canceled> {
    // Standard errors cost most of the time, and small changes need none.
    let first_steps = AdjustmentConfig { final_iterations: FIRST_STEPS, uncertainty_block_frames: None, ..at_end() };
    let about = adjusted(solved, free, &first_steps, progress)?;
    if about.cameras.iter().all(|camera| camera.radial.abs() < MIN_CHANGE) {
        return Ok(Vec::new());
    }
    let to_the_end = AdjustmentConfig { uncertainty_block_frames: Some(solved.independent_frames()), ..at_end() };
    let change = |(view, camera): (usize, &AdjustedCamera)| {
        let sigma = OVERCOUNT.sqrt() * camera.uncertainty?.sigma_radial?;
        Some(Change { view, value: camera.radial, sigma })
    };
    let found = adjusted(solved, free, &to_the_end, progress)?;
    let changes: Vec<Change> = found.cameras.iter().enumerate().filter_map(change).collect();
    tracing::debug!(?changes, "radial coefficients less the given ones");
    if let Some(common) = common_change(&changes) {
        return Ok(vec![suspicion(solved, &changes, common)]);
    }
    let certain = certain_of_any(changes.len());
    let single = changes.iter().filter(|change| change.counts(certain));
    Ok(single.map(|change| suspicion(solved, std::slice::from_ref(change), *change)).collect())
}

/// Goes on from an adjustment with the radial coefficients beside the focal lengths.
fn adjusted(
    solved: &Solved,
    free: &FreeAdjustment,
    config: &AdjustmentConfig,
    progress: &Progress,
) -> Result<Adjusted, Canceled> {
    let FreeAdjustment { intrinsics, keyframes, adjusted } = free;
    let input = AdjustmentInput {
        intrinsics,
        cameras: adjusted.cameras.iter().map(|camera| camera.camera_from_world).collect(),
        keyframes: keyframes.clone(),
        bones: &solved.bones(),
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: true,
        refine_delays: false,
        drift_over: None,
        refine_radial: true,
    };
    Ok(adjust(&input, config, progress)?.0)
}

/// What most cameras have in common: their weighted mean, where their median is as large. Its standard error is that of cameras which
/// err alike: what is constant about a person's keypoints, and where people walked, is the same for all of them and does not average
/// out (with independent errors the mean of eight right lenses was 3.9 standard errors off).
fn common_change(changes: &[Change]) -> Option<Change> {
    let median = median(&mut changes.iter().map(|change| change.value).collect::<Vec<_>>())?;
    let weight = |change: &Change| change.sigma.powi(-2);
    let total: f64 = changes.iter().map(weight).sum();
    let value = changes.iter().map(|change| weight(change) * change.value).sum::<f64>() / total;
    let sigma = changes.iter().map(|change| weight(change) * change.sigma).sum::<f64>() / total;
    let common = Change { view: changes[0].view, value, sigma };
    (changes.len() > 1 && common.counts(CERTAIN) && median * value > MIN_CHANGE * value.abs()).then_some(common)
}

/// About the cameras of `changes`, `common` to all.
fn suspicion(solved: &Solved, changes: &[Change], common: Change) -> Suspicion {
    let views: Vec<usize> = changes.iter().map(|change| change.view).collect();
    let lenses = || views.iter().map(|&view| solved.session().views[view].intrinsics.dist);
    let is_undone = |lens| matches!(lens, Distortion::OpenCv5([k1, ..]) if UNDISTORTED.contains(&(-common.value / k1)));
    let (is_undistorted, is_plain) = (lenses().all(is_undone), lenses().all(|lens| lens == Distortion::None));
    let size = format!("{:+.2} +- {:.2}", common.value, common.sigma);
    let (evidence, remedy) = if is_undistorted {
        (
            "the images look undistorted, though dist states a distortion".to_owned(),
            "leave dist out, or detect people in the images as recorded",
        )
    } else if is_plain {
        (
            format!("the images are distorted, by a k1 of {size}, though dist states none"),
            "give dist of the calibration, or detect people in undistorted images",
        )
    } else {
        (format!("the first coefficient of dist is off by {size}"), "give the calibration of these images")
    };
    let is_all = views.len() > 1 && views.len() == solved.unnamed(&[]).len();
    let cameras = if is_all { Vec::new() } else { solved.ids(&views) };
    let radial_change = (!is_undistorted).then_some(common.value);
    Suspicion { radial_change, ..Suspicion::new(Code::LensDistortion, cameras, evidence, remedy) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alike(n: usize, value: f64, sigma: f64) -> Vec<Change> {
        (0..n).map(|view| Change { view, value, sigma }).collect()
    }

    /// Eight right lenses, 1.4 standard errors off each; their mean was 4 of its own.
    #[test]
    fn errors_that_all_cameras_share_were_a_distortion() {
        assert!(common_change(&alike(8, -0.16, 0.114)).is_none());
        let found = common_change(&alike(8, -0.3, 0.04)).unwrap();
        assert!((found.value + 0.3).abs() < 1e-12 && (found.sigma - 0.04).abs() < 1e-12, "{found:?}");
        assert!(common_change(&alike(1, -0.3, 0.04)).is_none(), "of one lens nothing is common");
    }

    /// One of five right lenses, 3.03 standard errors off.
    #[test]
    fn the_largest_error_of_many_lenses_was_a_distortion() {
        let change = Change { view: 0, value: -0.1707, sigma: 0.0563 };
        assert!(change.counts(certain_of_any(1)) && !change.counts(certain_of_any(5)));
        assert!(Change { value: -0.3, ..change }.counts(certain_of_any(5)));
        assert!(!Change { value: 0.09, sigma: 0.001, ..change }.counts(CERTAIN), "small, however certain");
    }
}
