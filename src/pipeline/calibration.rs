//! The rounds of association, cameras and adjustment: from no start to cameras that everything seen agrees with.

use super::association::{Association, associate, from_clusters};
use super::bundle_adjustment::{self as ba, Adjusted, AdjustmentConfig, AdjustmentInput, CameraFreedom};
use super::camera_init::initial_rigs;
use super::instants::{FrameFilter, InstantBudget, instants, noise_factor};
use super::{Capture, PipelineError};
use crate::geometry::{Intrinsics, Rigid};
use crate::matching::clusters::clusters;
use crate::matching::pair_score::median;
use crate::matching::tracklets::{Tracklet, TrackletConfig, tracklets};
use crate::matching::view_graph::Rig;
use crate::progress::{Canceled, Progress};
use crate::session::reconstruction::StageReport;
use rayon::prelude::*;

/// Cameras and who is who under them.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// `camera_from_world` in units that are metres as far as bones tell.
    pub cameras: Vec<Option<Rigid>>,
    /// Who is who under these cameras.
    pub association: Association,
    /// The last adjustment.
    pub adjusted: Option<Adjusted>,
    /// Factor on the keypoints' standard deviations that the residuals ask for.
    pub noise: f64,
    /// Quality of the arrangement that was chosen, and of the best other one.
    pub rivals: [f64; 2],
    /// What happened.
    pub stages: Vec<StageReport>,
}

/// Arrangements that are tried out in full, and the share of the best one's quality that they must reach.
const MAX_TRIALS: usize = 3;
const TRIAL_SHARE: f64 = 0.5;

/// Skeletons in the adjustments of a trial, a round, the end. Errors of one person's detections are correlated over half
/// a second, so more than this adds cost and hardly information.
const TRIAL_INSTANTS: usize = 120;
const ROUND_INSTANTS: usize = 250;
const FINAL_INSTANTS: usize = 500;

/// Rounds of association and adjustment before the last one: the second changed associations in half of the trials, a
/// third in none.
const N_ROUNDS: usize = 2;

/// Estimates the cameras from nothing.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn estimate_cameras(capture: &Capture, progress: &Progress) -> Result<Calibration, PipelineError> {
    let config = TrackletConfig::default();
    let fps = capture.session.fps;
    let tracklets: Vec<Vec<Tracklet>> = capture.views.par_iter().map(|v| tracklets(v, fps, &config)).collect();
    progress.report(0.05, "people followed within each view");
    let (rigs, report) = initial_rigs(&capture.views, &tracklets, &capture.bones, capture.options.seed, progress)?;
    let mut calibration = best_trial(capture, &tracklets, &rigs, progress)?;
    calibration.stages.insert(0, report);
    progress.report(0.6, "cameras placed");
    for round in 0..N_ROUNDS {
        calibration = improved(capture, calibration, ROUND_INSTANTS, progress)?;
        progress.report(0.65 + 0.1 * round as f64, "detections given out anew");
    }
    improved(capture, calibration, FINAL_INSTANTS, progress)
}

/// Cameras that the session gives: associated under them and, where asked, adjusted.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn from_given_cameras(
    capture: &Capture,
    cameras: Vec<Option<Rigid>>,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    let (association, report) = associated(capture, &cameras, progress)?;
    let calibration =
        Calibration { cameras, association, adjusted: None, noise: 1.0, rivals: [1.0, 0.0], stages: vec![report] };
    match freedom {
        CameraFreedom::Held => Ok(calibration),
        CameraFreedom::Adjusted => improved(capture, calibration, FINAL_INSTANTS, progress),
    }
}

/// Tries the most promising arrangements as far as a first association of everybody; the one that explains most wins.
fn best_trial(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    rigs: &[Rig],
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    let mut best: Option<(f64, Calibration)> = None;
    let worth_it = rigs.iter().filter(|r| r.quality >= TRIAL_SHARE * rigs[0].quality).take(MAX_TRIALS);
    for (i, rig) in worth_it.enumerate() {
        let mut trial = trial(capture, tracklets, rig, progress)?;
        let rival = rigs.iter().enumerate().find(|(j, _)| *j != i).map_or(0.0, |(_, r)| r.quality);
        trial.rivals = [rig.quality, rival];
        let score = trial.association.explained * trial.cameras.iter().flatten().count() as f64;
        if best.as_ref().is_none_or(|(s, _)| score > *s) {
            best = Some((score, trial));
        }
    }
    match best {
        Some((_, calibration)) => Ok(calibration),
        None => from_given_cameras(capture, vec![None; capture.views.len()], CameraFreedom::Held, progress),
    }
}

/// One arrangement: tracklets grouped under it, a first adjustment, everybody associated.
fn trial(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    rig: &Rig,
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    let groups = clusters(&capture.views, tracklets, &rig.cameras);
    let rough = from_clusters(&capture.scene(&rig.cameras), tracklets, &groups);
    let start = Calibration {
        cameras: rig.cameras.clone(),
        association: rough,
        adjusted: None,
        noise: 1.0,
        rivals: [0.0; 2],
        stages: Vec::new(),
    };
    let mut adjusted = adjusted(capture, &start, TRIAL_INSTANTS, &|_| true, progress)?;
    let (association, report) = associated(capture, &adjusted.cameras, progress)?;
    adjusted.association = association;
    adjusted.stages.push(report);
    Ok(adjusted)
}

/// One round: adjustment, then association under the new cameras; kept only if no less is explained.
fn improved(
    capture: &Capture,
    before: Calibration,
    n_instants: usize,
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    let mut after = adjusted(capture, &before, n_instants, &|_| true, progress)?;
    let (association, report) = associated(capture, &after.cameras, progress)?;
    // A wrong association after a right start is the real danger: a round that explains less is thrown away.
    if association.explained < before.association.explained - 0.01 {
        return Ok(before);
    }
    after.association = association;
    after.stages.push(report);
    Ok(after)
}

fn associated(
    capture: &Capture,
    cameras: &[Option<Rigid>],
    progress: &Progress,
) -> Result<(Association, StageReport), Canceled> {
    associate(&capture.scene(cameras), capture.options.people, progress)
}

/// The cameras after an adjustment to a budget of instants, rescaled so that bones keep adult lengths.
fn adjusted(
    capture: &Capture,
    before: &Calibration,
    n_instants: usize,
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let session = capture.session;
    let budget = InstantBudget { max_instants: n_instants, noise: before.noise, metres_per_unit: 1.0 };
    let chosen = instants(session, &before.cameras, &before.association, budget, allowed);
    if chosen.is_empty() {
        return Ok(before.clone());
    }
    let intrinsics: Vec<Intrinsics> = session.views.iter().map(|v| v.intrinsics).collect();
    let input = AdjustmentInput {
        intrinsics: &intrinsics,
        cameras: before.cameras.clone(),
        instants: chosen,
        bones: &capture.adjusted_bones,
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: false,
    };
    let (adjusted, report) = ba::adjust(&input, &AdjustmentConfig::default(), progress)?;
    let cameras: Vec<Option<Rigid>> = adjusted.cameras.iter().map(|c| c.camera_from_world).collect();
    let mut instants = input.instants;
    for (instant, points) in instants.iter_mut().zip(&adjusted.points) {
        instant.points.clone_from(points);
    }
    let noise = before.noise * noise_factor(session, &cameras, &instants);
    let scale = bone_scale(capture, &adjusted);
    let cameras = cameras.into_iter().map(|c| c.map(|c| Rigid { translation: c.translation * scale, ..c })).collect();
    let mut stages = before.stages.clone();
    stages.push(report);
    Ok(Calibration { cameras, adjusted: Some(adjusted), noise, stages, ..before.clone() })
}

/// Metres per unit of the adjusted world, from the median bone: keeps the tracker's gates in metres.
fn bone_scale(capture: &Capture, adjusted: &Adjusted) -> f64 {
    let mut logs = Vec::new();
    for lengths in adjusted.bone_lengths.values() {
        for (length, bone) in lengths.iter().zip(&capture.bones) {
            logs.extend(length.map(|l| (bone.length / l).ln()));
        }
    }
    median(&mut logs).map_or(1.0, f64::exp)
}

/// Mean reprojection distance (px) of cameras from every other block of frames, judged on the rest.
///
/// `None` where a half of the frames is not enough. With held cameras both halves are judged with the same ones.
///
/// # Errors
/// [`Canceled`].
pub fn heldout_px(
    capture: &Capture,
    calibration: &Calibration,
    freedom: CameraFreedom,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let halves = [0, 1].map(|half| move |frame: usize| (frame / HELDOUT_BLOCK) % 2 == half);
    let mut sum = 0.0;
    for (trained, judged) in [(&halves[0], &halves[1]), (&halves[1], &halves[0])] {
        let cameras = match freedom {
            CameraFreedom::Held => calibration.cameras.clone(),
            CameraFreedom::Adjusted => adjusted(capture, calibration, ROUND_INSTANTS, trained, progress)?.cameras,
        };
        let Some(error) = judged_px(capture, calibration, &cameras, judged, progress)? else { return Ok(None) };
        sum += 0.5 * error;
    }
    Ok(Some(sum))
}

/// Frames of a block that is trained on or judged as a whole: neighbouring frames share their errors.
const HELDOUT_BLOCK: usize = 15;

/// Distances beyond this are wrong detections, and count as this much, px.
const HELDOUT_CLIP_PX: f64 = 25.0;

/// Mean clipped distance of points seen by at least three views to their reprojection, points alone adjusted.
fn judged_px(
    capture: &Capture,
    calibration: &Calibration,
    cameras: &[Option<Rigid>],
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Option<f64>, Canceled> {
    let session = capture.session;
    let budget = InstantBudget { max_instants: FINAL_INSTANTS, noise: calibration.noise, metres_per_unit: 1.0 };
    let mut chosen = instants(session, cameras, &calibration.association, budget, allowed);
    for instant in &mut chosen {
        let mut seen = vec![0u8; instant.points.len()];
        instant.observations.iter().for_each(|o| seen[o.keypoint] += 1);
        instant.observations.retain(|o| seen[o.keypoint] >= 3);
    }
    let intrinsics: Vec<Intrinsics> = session.views.iter().map(|v| v.intrinsics).collect();
    let input = AdjustmentInput {
        intrinsics: &intrinsics,
        cameras: cameras.to_vec(),
        instants: chosen,
        bones: &[],
        camera_freedom: CameraFreedom::Held,
        refine_focal: false,
    };
    let (judged, _) = ba::adjust(&input, &AdjustmentConfig::default(), progress)?;
    let (mut sum, mut n) = (0.0, 0usize);
    for (instant, points) in input.instants.iter().zip(&judged.points) {
        for o in &instant.observations {
            let (Some(point), Some(camera)) = (points[o.keypoint], &cameras[o.view]) else { continue };
            let pixel = intrinsics[o.view].pixel_from_camera(&camera.transform(&point));
            sum += pixel.map_or(HELDOUT_CLIP_PX, |p| (p - o.pixel).norm().min(HELDOUT_CLIP_PX));
            n += 1;
        }
    }
    Ok((n >= 100).then(|| sum / n as f64))
}
