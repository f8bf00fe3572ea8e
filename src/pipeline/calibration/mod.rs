//! The rounds of association, cameras and adjustment: from no start to cameras that everything seen agrees with.

mod consistency;
mod detector_noise;
mod held_out;
mod instants;
mod registration;

use super::config::Extrinsics;
use super::stages::association::{Association, associate, from_clusters};
use super::stages::bundle_adjustment::{self as ba, Adjusted, AdjustmentConfig, AdjustmentInput, CameraFreedom};
use super::stages::camera_init::initial_rigs;
use super::{Capture, PipelineError, result};
use crate::body::detector_noise::DetectorNoise;
use crate::geometry::{Intrinsics, Rigid, rotation};
use crate::matching::clusters::clusters;
use crate::matching::tracklets::{Tracklet, TrackletConfig, tracklets};
use crate::matching::view_graph::Rig;
use crate::optim::robust::median;
use crate::progress::{Canceled, Progress};
use crate::session::Session;
use crate::session::reconstruction::StageReport;
pub use consistency::{Consistent, made_consistent};
pub use held_out::heldout_px;
use instants::{FrameFilter, InstantBudget, instants, noise_factor, set_in_motion};
use rayon::prelude::*;

/// Cameras and who is who under them.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Calibration {
    /// `camera_from_world` in units that are metres as far as bones tell.
    pub cameras: Vec<Option<Rigid>>,
    /// Who is who under these cameras.
    pub association: Association,
    /// The last adjustment.
    pub adjusted: Option<Adjusted>,
    /// How far the detector errs: as published, times what the residuals ask for; once measured, as measured.
    pub noise: DetectorNoise,
    /// Share of keypoints that the best truly different arrangement explained; 0 without one.
    pub rival_explained: f64,
    /// What happened.
    pub stages: Vec<StageReport>,
}

impl Calibration {
    /// Cameras about which nothing else is known.
    fn unadjusted(capture: &Capture, cameras: Vec<Option<Rigid>>) -> Self {
        Self {
            cameras,
            association: Association::default(),
            adjusted: None,
            noise: DetectorNoise::published(capture.session.convention),
            rival_explained: 0.0,
            stages: Vec::new(),
        }
    }

    /// Learns from the clean detections of `session` how far the detector errs; where they are too few, what is known stands.
    fn measure_noise(&mut self, session: &Session) {
        if let Some(noise) = detector_noise::measured(session, &self.cameras, &self.association.tracks) {
            self.noise = noise;
        }
    }
}

/// Arrangements that are tried out in full, and the share of the best one's quality that they must reach.
const MAX_TRIALS: usize = 3;
const TRIAL_SHARE: f64 = 0.5;

/// How much one adjustment is worth.
#[derive(Debug, Clone, Copy)]
struct Effort {
    /// Skeletons that take part. Errors of one person's detections are correlated over half a second, so more cost time and
    /// bring hardly any information.
    max_instants: usize,
    /// Share of the cost below which a gain ends the work: the next association changes more than the last digits would.
    relative_decrease: f64,
    /// Seconds of one person that count as one independent block in the cameras' uncertainty; `None`: not computed.
    uncertainty_block_secs: Option<f64>,
    /// Whether cameras may be late.
    refine_delays: bool,
    /// Whether focal lengths may be off.
    refine_focal: bool,
}

const TRIAL: Effort = Effort {
    max_instants: 120,
    relative_decrease: 1e-3,
    uncertainty_block_secs: None,
    refine_delays: false,
    refine_focal: false,
};
const ROUND: Effort = Effort { max_instants: 250, relative_decrease: 1e-4, ..TRIAL };
/// Detector errors are correlated over a third of a second (AR(0.9) at 30 Hz); a block must span several such times.
const FINAL: Effort = Effort { max_instants: 500, relative_decrease: 1e-6, uncertainty_block_secs: Some(2.0), ..TRIAL };
/// A delay is told by moving points alone, of which there are fewer.
const TIMED: Effort = Effort { max_instants: 1500, relative_decrease: 1e-5, refine_delays: true, ..FINAL };
/// A focal length trades against distance, slowly: convergence counts.
const FOCAL: Effort = Effort { refine_focal: true, ..FINAL };

/// Settings of an adjustment whose uncertainty nobody asks for.
fn quick() -> AdjustmentConfig {
    AdjustmentConfig { relative_decrease: 1e-4, uncertainty_block_frames: None, ..AdjustmentConfig::default() }
}

/// Rounds of association and adjustment before the last one: the second changed associations in half of the trials, a
/// third in none.
const N_ROUNDS: usize = 2;

/// Cameras and who is who: from nothing, or from what the session gives; `given`: what may happen to cameras that it gives.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn calibrated(capture: &Capture, given: CameraFreedom, progress: &Progress) -> Result<Calibration, PipelineError> {
    if capture.options.extrinsics == Extrinsics::Estimate {
        return estimate_cameras(capture, progress);
    }
    let cameras = capture.session.views.iter().map(|v| v.camera_from_world).collect();
    from_given_cameras(capture, cameras, given, progress)
}

/// Estimates the cameras from nothing.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn estimate_cameras(capture: &Capture, progress: &Progress) -> Result<Calibration, PipelineError> {
    let tracklets = followed(capture);
    progress.report(0.05, "people followed within each view");
    let (rigs, report) = initial_rigs(&capture.views, &tracklets, &capture.bones, capture.options.seed, progress)?;
    let mut calibration = best_trial(capture, &tracklets, &rigs, progress)?;
    calibration.stages.insert(0, report);
    progress.report(0.6, "cameras placed");
    for round in 0..N_ROUNDS {
        registration::place_remaining(capture, &tracklets, &mut calibration);
        calibration = improved(capture, calibration, ROUND, progress)?;
        progress.report(0.65 + 0.1 * round as f64, "detections given out anew");
    }
    settled(capture, calibration, progress)
}

/// The arrangement that looks best before any adjustment; `None` for a camera that it does not place.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn initial_cameras(capture: &Capture, progress: &Progress) -> Result<Vec<Option<Rigid>>, PipelineError> {
    let (rigs, _) = initial_rigs(&capture.views, &followed(capture), &capture.bones, capture.options.seed, progress)?;
    Ok(rigs.into_iter().next().map_or_else(|| vec![None; capture.views.len()], |rig| rig.cameras))
}

/// People followed within each view.
fn followed(capture: &Capture) -> Vec<Vec<Tracklet>> {
    let (fps, config) = (capture.session.fps, TrackletConfig::default());
    capture.views.par_iter().map(|view| tracklets(view, fps, &config)).collect()
}

/// The last adjustment, unless [`made_consistent`] is still to come.
fn settled(capture: &Capture, calibration: Calibration, progress: &Progress) -> Result<Calibration, PipelineError> {
    if capture.options.denoise { Ok(calibration) } else { Ok(improved(capture, calibration, FINAL, progress)?) }
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
    let calibration = Calibration { association, stages: vec![report], ..Calibration::unadjusted(capture, cameras) };
    match freedom {
        CameraFreedom::Held => Ok(calibration),
        CameraFreedom::Adjusted => settled(capture, calibration, progress),
    }
}

/// Cameras and people of a recording whose times or lenses are only nearly known: under `cameras` where a round before has
/// found them, else from nothing or as the session gives them.
///
/// # Errors
/// [`PipelineError::Canceled`].
pub fn roughly_calibrated(
    capture: &Capture,
    cameras: Option<Vec<Option<Rigid>>>,
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    match cameras {
        Some(cameras) => from_given_cameras(capture, cameras, CameraFreedom::Held, progress),
        None => calibrated(capture, CameraFreedom::Held, progress),
    }
}

/// Tries the most promising arrangements as far as a first association of everybody; the one that explains most wins.
fn best_trial(
    capture: &Capture,
    tracklets: &[Vec<Tracklet>],
    rigs: &[Rig],
    progress: &Progress,
) -> Result<Calibration, PipelineError> {
    let worth_it = rigs.iter().filter(|r| r.quality >= TRIAL_SHARE * rigs[0].quality).take(MAX_TRIALS);
    let trials: Vec<Calibration> =
        worth_it.map(|rig| trial(capture, tracklets, rig, progress)).collect::<Result<_, PipelineError>>()?;
    let score = |c: &Calibration| c.association.explained * c.cameras.iter().flatten().count() as f64;
    let Some(best) = trials.iter().max_by(|a, b| score(a).total_cmp(&score(b))) else {
        let nothing = vec![None; capture.views.len()];
        return from_given_cameras(capture, nothing, CameraFreedom::Held, progress);
    };
    let rivals = trials.iter().filter(|t| differs(&t.cameras, &best.cameras));
    let rival_explained = rivals.map(|t| t.association.explained).fold(0.0, f64::max);
    Ok(Calibration { rival_explained, ..best.clone() })
}

/// Whether two adjusted arrangements are truly different: some pair of cameras stands more than 5 degrees apart.
fn differs(some: &[Option<Rigid>], others: &[Option<Rigid>]) -> bool {
    let both: Vec<(Rigid, Rigid)> = some.iter().zip(others).filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
    both.iter().enumerate().any(|(i, (a, b))| {
        both[..i].iter().any(|(c, d)| {
            let (one, other) = (*a * c.inverse(), *b * d.inverse());
            rotation::angle_between(&one.rotation, &other.rotation) > 5f64.to_radians()
        })
    })
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
    let start = Calibration { association: rough, ..Calibration::unadjusted(capture, rig.cameras.clone()) };
    let mut adjusted = adjusted(capture, &start, TRIAL, &|_| true, progress)?;
    let (association, report) = associated(capture, &adjusted.cameras, progress)?;
    adjusted.association = association;
    adjusted.stages.push(report);
    Ok(adjusted)
}

/// The cameras after an adjustment in which they may be late; how late is told by [`Calibration::adjusted`].
///
/// # Errors
/// [`Canceled`].
pub fn with_delays(capture: &Capture, before: &Calibration, progress: &Progress) -> Result<Calibration, Canceled> {
    adjusted(capture, before, TIMED, &|_| true, progress)
}

/// The cameras after an adjustment in which their focal lengths may be off; by how much is told by
/// [`Calibration::adjusted`].
///
/// # Errors
/// [`Canceled`].
pub fn with_focal_factors(
    capture: &Capture,
    before: &Calibration,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    adjusted(capture, before, FOCAL, &|_| true, progress)
}

/// One round: adjustment, then association under the new cameras; kept only if no less is explained.
fn improved(
    capture: &Capture,
    before: Calibration,
    effort: Effort,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let mut after = adjusted(capture, &before, effort, &|_| true, progress)?;
    let (association, report) = associated(capture, &after.cameras, progress)?;
    // A wrong association after a right start is the real danger: a round that explains less is thrown away.
    let n_placed = |c: &[Option<Rigid>]| c.iter().flatten().count();
    let fair = n_placed(&before.cameras) == before.association.n_views_placed;
    if fair && association.explained < before.association.explained - 0.01 {
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
    effort: Effort,
    allowed: FrameFilter,
    progress: &Progress,
) -> Result<Calibration, Canceled> {
    let session = capture.session;
    let budget = InstantBudget { max_instants: effort.max_instants, noise: &before.noise, metres_per_unit: 1.0 };
    let mut chosen = instants(session, &before.cameras, &before.association, budget, allowed);
    if chosen.is_empty() {
        return Ok(before.clone());
    }
    if effort.refine_delays {
        let paths = result::paths(capture, before, progress)?;
        set_in_motion(&mut chosen, session, &before.cameras, &paths);
    }
    let intrinsics: Vec<Intrinsics> = session.views.iter().map(|v| v.intrinsics).collect();
    let input = AdjustmentInput {
        intrinsics: &intrinsics,
        cameras: before.cameras.clone(),
        instants: chosen,
        bones: &capture.adjusted_bones,
        camera_freedom: CameraFreedom::Adjusted,
        refine_focal: effort.refine_focal,
        refine_delays: effort.refine_delays,
    };
    let uncertainty_block_frames = effort.uncertainty_block_secs.map(|s| ((s * session.fps).round() as usize).max(1));
    let relative_decrease = effort.relative_decrease;
    let config = AdjustmentConfig { relative_decrease, uncertainty_block_frames, ..AdjustmentConfig::default() };
    let (adjusted, report) = ba::adjust(&input, &config, progress)?;
    let cameras: Vec<Option<Rigid>> = adjusted.cameras.iter().map(|c| c.camera_from_world).collect();
    let mut instants = input.instants;
    for (instant, points) in instants.iter_mut().zip(&adjusted.points) {
        instant.points.clone_from(points);
    }
    let noise = before.noise.clone().scaled(noise_factor(session, &cameras, &instants));
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
