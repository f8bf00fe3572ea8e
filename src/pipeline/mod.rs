//! The stages, in order; whoever reads this page knows what the program does.

pub mod calibration;
pub mod checkpoints;
pub mod config;
pub mod focal_lengths;
pub mod inspection;
pub mod result;
pub mod stages;
pub mod synchronisation;

use crate::body::bones::{LENGTH_SIGMA, LimbBone, limb_bones};
use crate::body::{BodyModel, default_body};
use crate::geometry::Rigid;
use crate::matching::normalized::{NormalizedView, normalized_views};
use crate::matching::tracker::TrackerScene;
use crate::progress::{Canceled, Progress};
use crate::session::{Reconstruction, Session};
use calibration::{calibrated, heldout_px, made_consistent};
use checkpoints::Checkpoints;
pub use config::{CameraFacts, Options};
use config::{Extrinsics, IntrinsicsMode};
use focal_lengths::FocalLengths;
use result::Findings;
use stages::bundle_adjustment::CameraFreedom;
use stages::{bundle_adjustment, metric_scale};

/// Why a capture cannot be solved at all.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The caller asked to stop.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// An option asks for what the session does not hold.
    #[error("{option}: {reason}")]
    Option {
        /// JSON pointer into the options.
        option: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
    /// Nothing to solve.
    #[error("{reason}")]
    Unsolvable {
        /// Machine-readable code.
        code: &'static str,
        /// What is missing and the remedy.
        reason: String,
    },
}

/// [`reconstruct_with_body`] with the embedded body.
///
/// # Errors
/// As there.
pub fn reconstruct(session: &Session, options: &Options, progress: &Progress) -> Result<Reconstruction, PipelineError> {
    reconstruct_with_body(session, options, &default_body(), progress)
}

/// Recovers cameras and people from a session: the stages, top to bottom.
///
/// `body`: the model that every person is fitted with. The same session, options, body and instruction set give the same result, whatever the number of threads.
///
/// # Errors
/// [`PipelineError`] when the work was canceled, an option asks for what the session lacks, or nothing can be solved.
pub fn reconstruct_with_body(
    session: &Session,
    options: &Options,
    body: &BodyModel,
    progress: &Progress,
) -> Result<Reconstruction, PipelineError> {
    reconstruct_with_checkpoints(session, options, body, &Checkpoints::none(), progress)
}

/// [`reconstruct_with_body`] that goes on after the last stage that `checkpoints` keep; the same result to the last bit.
///
/// # Errors
/// As there.
pub fn reconstruct_with_checkpoints(
    session: &Session,
    options: &Options,
    body: &BodyModel,
    checkpoints: &Checkpoints,
    progress: &Progress,
) -> Result<Reconstruction, PipelineError> {
    // Whoever hands a body over has found it by its name.
    options.check(&CameraFacts::of(session), std::slice::from_ref(&options.body))?;
    if session.views.iter().all(|v| v.frames.iter().all(Vec::is_empty)) {
        let reason = "no camera detected anybody; check that the keypoint files are those of this take".to_owned();
        return Err(PipelineError::Unsolvable { code: "nobody_detected", reason });
    }
    let timing = checkpoints.stage("synchronisation", || synchronisation::timing(session, options, progress))?;
    let timed = timing.applied_to(session);
    let progress = &Shares { progress, before: timing.share_of_work() };
    let lenses = match options.intrinsics {
        IntrinsicsMode::Fixed => FocalLengths::given(&timed),
        IntrinsicsMode::RefineFocal => {
            checkpoints.stage("focal_lengths", || focal_lengths::refined(&timed, options, progress))?
        }
    };
    let timed = lenses.applied_to(&timed);
    let capture = Capture::new(&timed, options);

    let progress = &progress.after(lenses.share_of_work());
    let stage = progress.stage("cameras", 0, 0.0, 0.4);
    let calibration = checkpoints.stage("cameras", || calibrated(&capture, freedom(options), &stage))?;
    let n_placed = calibration.cameras.iter().flatten().count();
    if n_placed < 2 && session.views.len() > 1 {
        let reason = "no two cameras see the same people move; check that the cameras overlap, that frames are \
                      synchronised and that the intrinsics belong to these images"
            .to_owned();
        return Err(PipelineError::Unsolvable { code: "cameras_unsolvable", reason });
    }

    let stage = progress.stage("denoising", 1, 0.4, 0.15);
    let (calibration, consistent) = match options.denoise {
        true => checkpoints
            .stage("denoising", || made_consistent(&capture, calibration, freedom(options), &stage))?
            .over(&timed),
        false => (calibration, None),
    };
    let (clean, consistency) = consistent.map(|c| (c.session, (c.told, c.cleaning))).unzip();
    let capture = clean.as_ref().map_or(capture, |session| Capture::new(session, options));

    let stage = progress.stage("held_out_check", 2, 0.55, 0.1);
    let heldout_px =
        checkpoints.stage("held_out_check", || heldout_px(&capture, &calibration, freedom(options), &stage))?;

    let stage = progress.stage("joint_trajectories", 3, 0.65, 0.05);
    let paths = checkpoints.stage("joint_trajectories", || result::paths(&capture, &calibration, &stage))?;

    let stage = progress.stage("metric_scale", 4, 0.7, 0.02);
    let statures = |scale: f64| result::statures(&capture, &calibration, &paths, scale, body, &stage);
    let tracks = &calibration.association.tracks;
    let scale = checkpoints.stage("metric_scale", || {
        metric_scale::metric_scale(&capture, &calibration.cameras, tracks, &paths, &statures)
    })?;
    let findings = Findings::in_world(&capture, calibration, paths, scale, heldout_px);

    let stage_body = progress.stage("body_fit", 5, 0.72, 0.25);
    let mut reconstruction = findings.with_bodies(&capture, body, &stage_body)?;
    (reconstruction.report.consistency, reconstruction.repairs) = consistency.unzip();
    lenses.tell(&mut reconstruction);
    timing.tell(session, &mut reconstruction);
    Ok(reconstruction)
}

/// Stages that a caller is told of.
const N_STAGES: usize = 7;

/// The stages behind the synchronisation share what it leaves of the whole work.
struct Shares<'a> {
    progress: &'a Progress,
    before: f64,
}

impl Shares<'_> {
    fn stage(&self, name: &'static str, index: usize, start: f64, width: f64) -> Progress {
        let rest = 1.0 - self.before;
        self.progress.stage(name, index + 1, N_STAGES, self.before + rest * start, rest * width)
    }

    /// What is left once `share` of the rest is done, too.
    fn after(&self, share: f64) -> Self {
        Shares { progress: self.progress, before: self.before + (1.0 - self.before) * share }
    }
}

/// What may happen to cameras that have a place, given or found.
fn freedom(options: &Options) -> CameraFreedom {
    if options.extrinsics == Extrinsics::Fixed { CameraFreedom::Held } else { CameraFreedom::Adjusted }
}

/// What every stage reads: the recording as rays, and what the options ask for.
pub struct Capture<'a> {
    /// The recording.
    pub session: &'a Session,
    /// What the user asked for.
    pub options: &'a Options,
    /// Every detection as rays.
    pub views: Vec<NormalizedView>,
    /// Limb bones with reference lengths.
    pub bones: Vec<LimbBone>,
    /// The same bones as the adjustment knows them.
    pub adjusted_bones: Vec<bundle_adjustment::Bone>,
}

impl<'a> Capture<'a> {
    /// Prepares a session.
    pub fn new(session: &'a Session, options: &'a Options) -> Self {
        let bones = limb_bones(session.convention);
        let adjusted_bones =
            bones.iter().map(|b| bundle_adjustment::Bone { a: b.a, b: b.b, sigma: LENGTH_SIGMA }).collect();
        Self { session, options, views: normalized_views(session), bones, adjusted_bones }
    }

    /// The session under given cameras.
    pub fn scene<'b>(&'b self, cameras: &'b [Option<Rigid>]) -> TrackerScene<'b> {
        let (fps, n_frames) = (self.session.fps, self.session.n_frames);
        TrackerScene { views: &self.views, cameras, bones: &self.bones, fps, n_frames }
    }
}
