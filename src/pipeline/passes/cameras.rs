//! Cameras and persons: from people seen in common, or from the extrinsics that the session gives.

use crate::geometry::{Rigid, rotation};
use crate::matching::clusters::clusters;
use crate::matching::tracklets::Tracklet;
use crate::matching::view_graph::Rig;
use crate::pipeline::calibration::Calibration;
use crate::pipeline::capture::Capture;
use crate::pipeline::passes::adjustment::{ALL_FRAMES, Effort, adjusted, adjusted_and_associated};
use crate::pipeline::stages::association::{associate, from_clusters};
use crate::pipeline::stages::camera_init::initial_rigs;
use crate::pipeline::stages::camera_registration::register_remaining;
use crate::progress::{Canceled, Progress};

/// Largest number of arrangements tried in full, and the smallest share of the best one's quality for a trial.
const MAX_TRIALS: usize = 3;
const TRIAL_SHARE: f64 = 0.5;

/// Adjusted cameras that are within so many degrees of others show the same people. Of the further arrangements of 59 captures, all more
/// than 5 degrees from the first one's cameras before the adjustment, 66 of 96 were there after it.
const SAME_DEG: f64 = 0.5;

/// Most rounds of adjustment and association before the final one: the second changed associations in half of the trials, a
/// third in none.
const N_ROUNDS: usize = 2;

/// With all cameras placed, a round that changes the share of explained detections by less is the last, since the final adjustment and
/// association follow. On 95 captures of all presets cameras and joints came as close as with two rounds throughout.
const SETTLED_SHARE: f64 = 0.002;

/// Where the final bundle adjustment runs, [`Effort::last`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FinalAdjustment {
    /// At the end of this pass, on the detections as given.
    Here,
    /// In the denoising pass on repaired detections, or nowhere because the cameras are held.
    Elsewhere,
}

/// Cameras and persons: estimated without a start, or under the session's extrinsics.
pub fn calibrated(capture: &Capture, last: FinalAdjustment, progress: &Progress) -> Result<Calibration, Canceled> {
    let mut steps = progress.steps(if last == FinalAdjustment::Here { [0.75, 0.25] } else { [1.0, 0.0] });
    let calibration = if capture.estimates_extrinsics() {
        estimated(capture, &steps.begin("estimating cameras"))?
    } else {
        let given = capture.session.views.iter().map(|v| v.camera_from_world).collect();
        under_cameras(capture, given, &steps.begin("associating detections"))?
    };
    match last {
        FinalAdjustment::Here => {
            let effort = Effort::last(capture.options);
            adjusted_and_associated(capture, calibration, effort, &steps.begin("adjusting cameras"))
        }
        FinalAdjustment::Elsewhere => Ok(calibration),
    }
}

/// Cameras and persons of a recording whose times or focal lengths are still approximate: under `cameras` where an
/// earlier round has estimated them, else [`calibrated`].
pub fn roughly_calibrated(
    capture: &Capture,
    cameras: Option<Vec<Option<Rigid>>>,
    last: FinalAdjustment,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    match cameras {
        Some(cameras) => under_cameras(capture, cameras, progress),
        None if capture.estimates_extrinsics() => calibrated(capture, last, progress),
        None => calibrated(capture, FinalAdjustment::Elsewhere, progress),
    }
}

/// The arrangement that scores best before any adjustment: `camera_from_world` per view, `None` where it is not placed.
pub fn initial_cameras(capture: &Capture, progress: &Progress) -> Result<Vec<Option<Rigid>>, Canceled> {
    let (rigs, _) = initial_rigs(capture, &capture.tracklets(), progress)?;
    Ok(rigs.into_iter().next().map_or_else(|| vec![None; capture.views.len()], |rig| rig.cameras))
}

/// The best arrangement of the cameras and the persons under it, after a first adjustment.
pub fn first_arrangement(capture: &Capture, progress: &Progress) -> Result<Calibration, Canceled> {
    let tracklets = capture.tracklets();
    let (rigs, _) = initial_rigs(capture, &tracklets, progress)?;
    best_trial(capture, &tracklets, rigs.get(..1).unwrap_or_default(), progress)
}

/// Estimates the cameras without a start.
fn estimated(capture: &Capture, progress: &Progress) -> Result<Calibration, Canceled> {
    let mut steps = progress.steps([0.05, 0.3, 0.3, 0.15, 0.15]);
    steps.begin("following people within each view");
    let tracklets = capture.tracklets();
    let comparing = steps.begin("comparing pairs of cameras");
    let (rigs, report) = initial_rigs(capture, &tracklets, &comparing)?;
    let trying = steps.begin("trying arrangements of the cameras");
    let mut calibration = best_trial(capture, &tracklets, &rigs, &trying)?;
    calibration.stages.insert(0, report);
    for _ in 0..N_ROUNDS {
        let round = steps.begin("registering the remaining cameras");
        let (n_placed, explained) = (calibration.n_placed(), calibration.association.explained);
        register_remaining(capture, &tracklets, &mut calibration);
        calibration = adjusted_and_associated(capture, calibration, Effort::ROUND, &round)?;
        let is_settled = (calibration.association.explained - explained).abs() < SETTLED_SHARE;
        if n_placed == capture.views.len() && is_settled {
            break;
        }
    }
    Ok(calibration)
}

/// Persons under known cameras; nothing is adjusted.
fn under_cameras(capture: &Capture, cameras: Vec<Option<Rigid>>, progress: &Progress) -> Result<Calibration, Canceled> {
    let (association, report) = associate(capture, &cameras, progress)?;
    Ok(Calibration { association, stages: vec![report], ..Calibration::unadjusted(capture, cameras) })
}

/// Tries the best arrangements as far as a first association; returns the one that explains most.
fn best_trial(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    rigs: &[Rig],
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let is_promising = |rig: &&Rig| rig.quality >= TRIAL_SHARE * rigs[0].quality;
    let candidates: Vec<&Rig> = rigs.iter().filter(is_promising).take(MAX_TRIALS).collect();
    let mut steps = progress.steps(vec![1.0; candidates.len()]);
    let mut trials: Vec<Calibration> = Vec::with_capacity(candidates.len());
    for (i, rig) in candidates.iter().enumerate() {
        let step = steps.begin(format!("trying arrangement {} of {} of the cameras", i + 1, candidates.len()));
        let mut steps = step.steps([3.0, 1.0]);
        let adjusted = adjusted_arrangement(capture, tracklets, rig, &steps.begin("adjusting cameras and points"))?;
        if !trials.iter().any(|known| is_same(&known.cameras, &adjusted.cameras)) {
            trials.push(with_association(capture, adjusted, &steps.begin("associating detections"))?);
        }
    }
    tracing::debug!(n = candidates.len(), n_different = trials.len(), "arrangements of the cameras");
    let score = |c: &Calibration| c.association.explained * c.n_placed() as f64;
    let Some(best) = trials.iter().max_by(|a, b| score(a).total_cmp(&score(b))) else {
        return under_cameras(capture, vec![None; capture.views.len()], progress);
    };
    let rivals = trials.iter().filter(|t| differs(&t.cameras, &best.cameras));
    let rival_explained = rivals.map(|t| t.association.explained).fold(0.0, f64::max);
    Ok(Calibration { rival_explained, ..best.clone() })
}

/// Whether two adjusted arrangements differ clearly: the relative rotation of some pair of cameras by over 5 degrees.
fn differs(some: &[Option<Rigid>], others: &[Option<Rigid>]) -> bool {
    largest_turn(some, others) > 5f64.to_radians()
}

/// Whether two adjustments have ended at one arrangement, under which people are the same.
fn is_same(one: &[Option<Rigid>], other: &[Option<Rigid>]) -> bool {
    one.iter().zip(other).all(|(a, b)| a.is_some() == b.is_some()) && largest_turn(one, other) < SAME_DEG.to_radians()
}

/// Largest difference of the relative rotation of two cameras, rad.
fn largest_turn(some: &[Option<Rigid>], others: &[Option<Rigid>]) -> f64 {
    let both: Vec<(Rigid, Rigid)> = some.iter().zip(others).filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
    let turn = |((a, b), (c, d)): (&(Rigid, Rigid), &(Rigid, Rigid))| {
        let (one, other) = (*a * c.inverse(), *b * d.inverse());
        rotation::angle_between(&one.rotation, &other.rotation)
    };
    let pairs = both.iter().enumerate().flat_map(|(i, one)| both[..i].iter().map(move |other| (one, other)));
    pairs.map(turn).fold(0.0, f64::max)
}

/// One arrangement after a first adjustment to tracklets that are grouped under it.
fn adjusted_arrangement(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    rig: &Rig,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let groups = clusters(&capture.views, tracklets, &rig.cameras);
    let association = from_clusters(&capture.scene(&rig.cameras), tracklets, &groups);
    let start = Calibration { association, ..Calibration::unadjusted(capture, rig.cameras.clone()) };
    adjusted(capture, &start, Effort::TRIAL, ALL_FRAMES, progress)
}

/// The association of all detections under adjusted cameras.
fn with_association(capture: &Capture, adjusted: Calibration, progress: &Progress) -> Result<Calibration, Canceled> {
    let (association, report) = associate(capture, &adjusted.cameras, progress)?;
    let mut stages = adjusted.stages;
    stages.push(report);
    Ok(Calibration { association, stages, ..adjusted })
}
