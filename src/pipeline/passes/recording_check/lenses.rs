//! Calibrations that belong elsewhere: to the images of another camera, to images of another size, or of another shape.
//!
//! Known limit: cameras with equal calibrations cannot be distinguished, whatever their files are named.

use super::solved::{MAX_KEYFRAMES, Solved};
use crate::geometry::{Intrinsics, Rigid};
use crate::optim::robust::median;
use crate::pipeline::calibration::CameraFreedom;
use crate::pipeline::focal_spread::OVERCOUNT;
use crate::pipeline::passes::adjustment::ALL_FRAMES;
use crate::pipeline::stages::bundle_adjustment::adjust;
use crate::pipeline::stages::bundle_adjustment::input::{AdjustmentConfig, AdjustmentInput};
use crate::pipeline::stages::keyframe_selection::select_keyframes;
use crate::pipeline::stages::recording_check::lens::{Lens, SeenPeople};
use crate::pipeline::stages::recording_check::parameters::SMALLER;
use crate::progress::{Canceled, Progress};
use crate::session::{Suspicion, SuspicionCode as Code, View};
use rayon::prelude::*;

/// Share of the keypoints that a detector may place outside its images.
const OUTSIDE: f64 = 0.01;

/// Another lens is proposed where a camera's people fit it this much better, and no worse than the given one with another focal
/// length. Most of a lens that differs in its principal point is taken for a turn of the camera: two real cameras whose files are
/// exchanged gain 2 %, and two whose lenses are as published, which is off by 1 to 3 %, gain 0.6 %.
const BETTER: f64 = 0.987;
const NOT_WORSE: f64 = 1.05;

/// Smallest difference between the shapes of pixels, of logarithms: calibrations state `fy / fx` to 0.5 %.
const MIN_STRETCH: f64 = 0.03;

/// Share of detections without a person, beyond the usual one, from which a camera has lost its people.
const LOST: f64 = 0.2;

/// Logarithm of the likelihood ratio from which calibrations belong elsewhere: published lenses of real cameras, which are off by 1 to
/// 3 %, reach 36 against those of their neighbours over four seconds, exchanged files 50 and more.
const MIN_LOG_EVIDENCE: f64 = 43.0;

/// The given lenses with free focal lengths may be likelier by this logarithm, for their number: where they are much likelier, it is
/// the focal lengths that are wrong.
const MAX_LOG_RATIO: f64 = 5.0;

/// The remedy for two cameras with each other's files.
pub(super) const EXCHANGE: &str = "exchange their keypoint files, or their calibrations";

/// Whether focal lengths are adjusted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Focal {
    Held,
    Free,
}

/// Cameras with other lenses than the given ones.
struct Proposal {
    code: Code,
    /// Views with their lenses and the poses that go with these.
    changed: Vec<(usize, Intrinsics, Rigid)>,
    /// Size of the images over that of the calibration, where it differs.
    image_scale: Option<f64>,
    /// Robust costs of the resections over those under the given lenses.
    cost_ratio: f64,
}

/// The calibrations that belong elsewhere; resections propose, two adjustments of all cameras decide.
pub(super) fn misplaced_lenses(
    solved: &Solved,
    resections: &[Option<Lens>],
    progress: &Progress,
) -> Result<Option<Suspicion>, Canceled> {
    let Some(proposal) = likeliest(solved, resections) else { return Ok(None) };
    let given = solved.given.intrinsics();
    let (mut intrinsics, mut cameras) = (given.clone(), solved.calibration.cameras.clone());
    for (view, lens, pose) in &proposal.changed {
        (intrinsics[*view], cameras[*view]) = (*lens, Some(*pose));
    }
    let as_given = cost(solved, &given, solved.calibration.cameras.clone(), Focal::Held, progress)?;
    let proposed = cost(solved, &intrinsics, cameras, Focal::Held, progress)?;
    let log_evidence = (as_given - proposed) / OVERCOUNT;
    if log_evidence < MIN_LOG_EVIDENCE {
        return Ok(None);
    }
    let (resected_lenses, cameras) = solved.resected(resections, solved.calibration.cameras.clone());
    let focal_only = cost(solved, &resected_lenses, cameras, Focal::Free, progress)?;
    let log_ratio = (proposed - focal_only) / OVERCOUNT;
    let views: Vec<usize> = proposal.changed.iter().map(|(view, ..)| *view).collect();
    tracing::debug!(?proposal.code, ?views, proposal.cost_ratio, log_evidence, log_ratio, "the likeliest other lenses");
    if log_ratio > MAX_LOG_RATIO {
        return Ok(None);
    }
    let (evidence, remedy) = match proposal.code {
        Code::CamerasExchanged => ("each shows the people better with the lens of the other".to_owned(), EXCHANGE),
        Code::PixelAspect => (
            format!("the people agree with images that are {} than K says", shape(&given, &proposal.changed[0])),
            "give fx and cx, or fy and cy, of the images in which people were detected: they follow width and height",
        ),
        _ => (
            format!(
                "K and all keypoints suit images of {}x{} pixels",
                proposal.changed[0].1.width, proposal.changed[0].1.height
            ),
            "give K and the size of the images in which people were detected",
        ),
    };
    let suspicion = Suspicion::new(proposal.code, solved.ids(&views), evidence, remedy);
    Ok(Some(Suspicion { image_scale: proposal.image_scale, ..suspicion }))
}

/// The proposal whose resections gain most.
fn likeliest(solved: &Solved, resections: &[Option<Lens>]) -> Option<Proposal> {
    let (people, lenses) = (solved.people(), solved.given.intrinsics());
    let views = solved.unnamed(&[]);
    // What each camera sees, with its costs under the given lens, and under it with the best focal length.
    let costs = |view: usize| {
        let seen = SeenPeople::of(&people, view).filter(|_| views.contains(&view))?;
        let own = seen.under_lens(&lenses[view]).1;
        Some((seen, own, resections[view].map_or(own, |lens| lens.cost)))
    };
    let given: Vec<Option<(SeenPeople, f64, f64)>> = (0..lenses.len()).into_par_iter().map(costs).collect();
    let proposal = |code: Code, image_scale: Option<f64>, changes: Vec<(usize, Intrinsics)>| {
        let (mut changed, mut sums) = (Vec::new(), (0.0, 0.0));
        for (view, lens) in changes {
            let (seen, own, focal_only) = given[view].as_ref()?;
            let (pose, cost) = seen.under_lens(&lens);
            tracing::trace!(view, ?code, own, focal_only, cost, "resection with another lens");
            if cost > NOT_WORSE * focal_only {
                return None;
            }
            changed.push((view, lens, pose));
            sums = (sums.0 + cost, sums.1 + own);
        }
        let cost_ratio = sums.0 / sums.1;
        (cost_ratio < BETTER).then_some(Proposal { code, changed, image_scale, cost_ratio })
    };
    let pairs = views.iter().flat_map(|&b| views.iter().map(move |&a| (a, b))).filter(|&(a, b)| a < b);
    let differing = pairs.filter(|&(a, b)| lenses[a] != lenses[b]);
    let exchanged = differing.map(|(a, b)| (Code::CamerasExchanged, None, vec![(a, lenses[b]), (b, lenses[a])]));
    let sizes = views.iter().flat_map(|&view| SMALLER.map(|factor| (view, factor)));
    let smaller = sizes.filter(|&(view, factor)| lies_within(&solved.session().views[view], factor));
    let resized =
        smaller.map(|(view, factor)| (Code::Resolution, Some(factor), vec![(view, lenses[view].resized(factor))]));
    // A camera that was moved has lost its people for a while, and what is left suits any shape.
    let assigned = solved.assigned_shares();
    let usual = median(&mut views.iter().map(|&view| assigned[view]).collect::<Vec<_>>())?;
    let stretched = views.par_iter().filter(|&&view| assigned[view] > usual - LOST).filter_map(|&view| {
        let aspect = given[view].as_ref()?.0.likeliest_aspect();
        let changed = || (Code::PixelAspect, None, vec![(view, lenses[view].with_aspect_factor(aspect))]);
        (aspect.ln().abs() > MIN_STRETCH).then(changed)
    });
    let all: Vec<_> = exchanged.chain(resized).collect();
    let proposals: Vec<Proposal> = all
        .into_par_iter()
        .chain(stretched)
        .filter_map(|(code, image_scale, changes)| proposal(code, image_scale, changes))
        .collect();
    proposals.into_iter().min_by(|x, y| x.cost_ratio.total_cmp(&y.cost_ratio))
}

/// In words, the shape of a view's images against the given lens.
fn shape(given: &[Intrinsics], (view, lens, _): &(usize, Intrinsics, Rigid)) -> String {
    let stretch = lens.fy / lens.fx / (given[*view].fy / given[*view].fx);
    let (percent, direction) = if stretch > 1.0 { (stretch - 1.0, "higher") } else { (1.0 / stretch - 1.0, "wider") };
    format!("{:.0} % {direction}", 100.0 * percent)
}

/// Whether all keypoints lie in this share of the image's width and height.
pub(super) fn lies_within(view: &View, factor: f64) -> bool {
    let View { intrinsics, frames, .. } = view;
    let (width, height) = (factor * f64::from(intrinsics.width), factor * f64::from(intrinsics.height));
    let keypoints = || frames.iter().flatten().flat_map(|d| &d.keypoints).filter(|k| k.is_present());
    let outside = keypoints().filter(|k| k.pixel.x > width || k.pixel.y > height).count();
    outside as f64 <= OUTSIDE * keypoints().count() as f64
}

/// Cost of an adjustment of all cameras and points, in squared standard deviations.
fn cost(
    solved: &Solved,
    intrinsics: &[Intrinsics],
    cameras: Vec<Option<Rigid>>,
    focal: Focal,
    progress: &Progress,
) -> Result<f64, Canceled> {
    let input = AdjustmentInput {
        intrinsics,
        keyframes: select_keyframes(solved.repaired, solved.calibration, &cameras, MAX_KEYFRAMES, ALL_FRAMES),
        cameras,
        bones: &solved.bones(),
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: focal == Focal::Free,
        refine_delays: false,
        drift_over: None,
        refine_radial: false,
    };
    let config = AdjustmentConfig { uncertainty_block_frames: None, ..AdjustmentConfig::default() };
    Ok(adjust(&input, &config, progress)?.1.cost_after.unwrap_or(0.0))
}
