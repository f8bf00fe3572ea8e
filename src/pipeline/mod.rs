//! The pipeline: every pass over a session, in order.
//!
//! | # | pass | stages, in order | runs |
//! |---|---|---|---|
//! | 1 | [`synchronisation`](passes::synchronisation) | time offsets in whole frames | `sync: estimate`; once |
//! | | | pass 3, keyframe selection, bundle adjustment with delays, and with focal lengths where these are open | 1 to 6 rounds |
//! | 2 | [`focal_lengths`](passes::focal_lengths) | pass 3, bundle adjustment with focal lengths | `refine_focal`; 1 or 2 rounds |
//! | | [`unknown_lenses`](passes::unknown_lenses) | camera initialisation | `estimate`, or no K; 8 candidates |
//! | | | keyframe selection, bundle adjustment with focal lengths, association | 3 candidates, then up to 4 rounds |
//! | 3 | [`cameras`](passes::cameras) | camera initialisation | `extrinsics: estimate`; once |
//! | | | keyframe selection, bundle adjustment, association | up to 3 arrangements; association once for those that end alike |
//! | | | camera registration, keyframes, bundle adjustment, association | 1 or 2 rounds |
//! | | | association under the given cameras | `extrinsics: fixed` or `refine`; once |
//! | | | final bundle adjustment, association | `denoise: false`, not `fixed`; once |
//! | 4 | [`denoising`](passes::denoising) | trajectories, repair of detections, detector noise | `denoise: true`; twice |
//! | | | in between: final bundle adjustment (not `fixed`), association | once |
//! | 5 | [`held_out_check`](passes::held_out_check) | bundle adjustment on a half of the frames, error on the rest | 2 halves |
//! | 6 | [`joint_trajectories`](stages::joint_trajectories) | smooth trajectories of the keypoints | once |
//! | 7 | [`recording_check`](passes::recording_check) | mistakes in the files that the solution shows | several cameras; once |
//! | | | in between: bundle adjustment with delays and focal lengths | once |
//! | | [`correction`](passes::correction) | repair of detections, trajectories | `corrections`; once |
//! | | | pass 5 | where they leave cameras out |
//! | 8 | [`metric_scale`] | scale; for `scale: height` statures by body fit | once; up to 4 fits |
//! | 9 | [`result`] | world frame, hands given to people and sides where the convention has hands, body fit | once |
//! | | | within it cameras and bodies together, then smooth trajectories again | not `fixed`, several cameras; once |
//! | | | fit of hands | conventions with hands, several cameras; once |
//! | | | fit statistics, verdict | once |
//!
//! In passes 1 and 2 the rounds after the first keep the cameras of the round before and only associate. The final bundle adjustment
//! of estimated or refined cameras runs once per calibration: in pass 4 on repaired detections, or without it at the end of pass 3.
//!
//! Nouns (`calibration`, `camera_clock`, `capture`, `config`, `continuation`, `corrections`, `error`, `focal_lengths`, `focal_spread`, `keyframe`, `option_kind`, `option_table`, `planned_stages`, `provisional`, `time_windows`, `unsolvable`, `up_direction`) import no stage; stages import nouns and no other stage;
//! passes import stages; this file imports passes.

pub mod calibration;
pub mod camera_clock;
pub mod capture;
pub mod checkpoints;
pub mod config;
pub mod continuation;
pub mod corrections;
pub mod error;
pub mod focal_lengths;
pub mod focal_spread;
pub mod inspection;
pub mod keyframe;
pub mod option_kind;
pub mod option_reference;
pub mod option_table;
pub mod passes;
mod planned_stages;
pub mod provisional;
pub mod repair;
pub mod result;
pub mod stages;
mod time_windows;
pub mod unsolvable;
pub mod up_direction;

use crate::body::{BodyModel, default_body};
use crate::progress::{Progress, Stages};
use crate::session::{JointTrajectory, PersonId, Reconstruction, Session, Suspicion, without_border_keypoints};
use calibration::{Calibration, CameraFreedom};
use capture::Capture;
use checkpoints::Checkpoints;
pub use config::{CameraFacts, Options};
use config::{Extrinsics, IntrinsicsMode, Repair, Sync};
pub use continuation::Continuation;
use continuation::Placed;
use corrections::{CorrectedPeople, corrected_people};
pub use error::PipelineError;
use focal_lengths::FocalLengths;
use passes::cameras::{FinalAdjustment, calibrated};
use passes::correction::corrected;
use passes::denoising::denoised_capture;
use passes::focal_lengths::refined_focal_lengths;
use passes::held_out_check::heldout_px;
use passes::recording_check::solved::Solved;
use passes::recording_check::{checked, mistake_of_unsolved};
use passes::synchronisation::{Timing, estimated_timing};
use passes::unknown_lenses::estimated_focal_lengths;
use planned_stages::{CORRECTED_STAGES, LAST_STAGES, corrected_stage_secs, stage_secs};
use provisional::{ProvisionalScene, Watcher};
use repair::{MAX_REPAIRS, known_mistakes, repaired, with_repairs};
use result::{FittedResult, Solution, statures};
use stages::joint_trajectories::joint_trajectories;
use stages::metric_scale;
use std::borrow::Cow;
use std::ops::ControlFlow;
use unsolvable::CameraEvidence;

/// [`reconstruct_with_body`] with the embedded body.
pub fn reconstruct(session: &Session, options: &Options, progress: &Progress) -> Result<Reconstruction, PipelineError> {
    reconstruct_with_body(session, options, &default_body(), progress)
}

/// Recovers cameras and people from a session.
///
/// `body`: the model that is fitted to every person. The same session, options, body and instruction set give the same
/// result, whatever the number of threads.
///
/// # Errors
/// [`PipelineError`] when the work was canceled, an option does not fit the session, or nothing can be solved.
pub fn reconstruct_with_body(
    session: &Session,
    options: &Options,
    body: &BodyModel,
    progress: &Progress,
) -> Result<Reconstruction, PipelineError> {
    reconstruct_with_checkpoints(session, options, body, &Checkpoints::none(), progress)
}

/// [`reconstruct_with_body`] that resumes after the last pass stored in `checkpoints`; the result is the same to the bit.
pub fn reconstruct_with_checkpoints(
    session: &Session,
    options: &Options,
    body: &BodyModel,
    checkpoints: &Checkpoints,
    progress: &Progress,
) -> Result<Reconstruction, PipelineError> {
    solve(session, options, body, checkpoints, None, &Watcher::none(), progress).map(|solved| solved.reconstruction)
}

/// A result, and what solves of the same session with other corrections continue from.
#[derive(Debug, Clone)]
pub struct SolvedSession {
    /// The result.
    pub reconstruction: Reconstruction,
    /// Cameras and people of the solve without corrections.
    pub continuation: Continuation,
}

/// Solves a session as [`reconstruct_with_checkpoints`] does.
///
/// `earlier`: from a solve of this session with the same [`Options::without_corrections`]. With corrections it saves the passes that
/// find cameras and people, and changes no bit of the result; without them it is not used. `watcher`: sees cameras and people
/// as they are known after passes 3, 4 and 6, and after corrections.
///
/// # Errors
/// Those of [`reconstruct_with_body`]; [`PipelineError::Option`] also for a correction that does not fit the people.
pub fn solve(
    session: &Session,
    options: &Options,
    body: &BodyModel,
    checkpoints: &Checkpoints,
    earlier: Option<&Continuation>,
    watcher: &Watcher,
    progress: &Progress,
) -> Result<SolvedSession, PipelineError> {
    // The caller has already looked up `options.body`.
    options.check(&CameraFacts::of(session), std::slice::from_ref(&options.body))?;
    require_detections(session)?;
    if let Some(continuation) = earlier.filter(|_| !options.corrections.is_empty()) {
        let (session, options) = continuation.repaired(session, options);
        let checkpoints = checkpoints.after_repairs(continuation.repairs().len());
        let applied = continuation.repairs();
        let attempt = Attempt {
            session: &session,
            options: &options,
            body,
            checkpoints: &checkpoints,
            applied,
            may_repair: false,
            watcher,
        };
        return attempt.corrected(continuation, progress);
    }
    let mut applied = Vec::new();
    let (mut repaired_session, mut repaired_options) = (Cow::Borrowed(session), options.clone());
    let mut n_repairs = 0;
    loop {
        let checkpoints = checkpoints.after_repairs(applied.len());
        let attempt = Attempt {
            session: &repaired_session,
            options: &repaired_options,
            body,
            checkpoints: &checkpoints,
            applied: &applied,
            may_repair: options.repair == Repair::Auto && n_repairs < MAX_REPAIRS,
            watcher,
        };
        match attempt.outcome(progress)? {
            Outcome::Solved(solved) => return Ok(*solved),
            Outcome::Repaired(repair) => {
                let Repaired { session, options, suspicions } = *repair;
                n_repairs += usize::from(!suspicions.iter().all(|suspicion| suspicion.code.is_always_undone()));
                for suspicion in suspicions {
                    tracing::info!(%suspicion, "the recording is repaired and solved again");
                    applied.push(Suspicion { applied: true, ..suspicion });
                }
                (repaired_session, repaired_options) = (Cow::Owned(session), options);
            }
        }
    }
}

/// The session that a result belongs to: `session` with the repairs that were applied ([`Repair::Auto`]), or as it is. Keypoints of the
/// result have its names, its pixels are those that the result's cameras explain.
pub fn as_solved<'s>(session: &'s Session, options: &Options, result: &Reconstruction) -> Cow<'s, Session> {
    let applied: Vec<Suspicion> = result.report.suspicions.iter().filter(|s| s.applied).cloned().collect();
    // Where the borders are is known once mistakes about the size of the images are repaired.
    without_border_keypoints(with_repairs(session, options, &applied).0)
}

/// One way through all passes.
struct Attempt<'a> {
    session: &'a Session,
    options: &'a Options,
    body: &'a BodyModel,
    checkpoints: &'a Checkpoints,
    /// The repairs so far.
    applied: &'a [Suspicion],
    /// Whether every mistake that can be repaired ends the attempt.
    may_repair: bool,
    watcher: &'a Watcher<'a>,
}

enum Outcome {
    Solved(Box<SolvedSession>),
    Repaired(Box<Repaired>),
}

/// A recording without the mistake that ended an attempt.
struct Repaired {
    session: Session,
    options: Options,
    suspicions: Vec<Suspicion>,
}

impl Attempt<'_> {
    /// The recording without the first of some mistakes that can be repaired, in all cameras that have it.
    fn repair(&self, found: &[Suspicion]) -> Option<Outcome> {
        let repair = |(session, options): (&Session, &Options), suspicion: &Suspicion| {
            repaired(session, options, suspicion).map(|(session, options)| Repaired {
                session,
                options,
                suspicions: vec![suspicion.clone()],
            })
        };
        let mut rest = found.iter().filter(|suspicion| self.may_repair || suspicion.code.is_always_undone());
        let mut first = rest.find_map(|suspicion| repair((self.session, self.options), suspicion))?;
        let code = first.suspicions[0].code;
        for suspicion in rest.filter(|suspicion| suspicion.code == code) {
            // An option that is chosen already repairs this one too.
            if let Some(next) = repair((&first.session, &first.options), suspicion) {
                (first.session, first.options) = (next.session, next.options);
            }
            first.suspicions.push(suspicion.clone());
        }
        Some(Outcome::Repaired(Box::new(first)))
    }

    fn outcome(&self, progress: &Progress) -> Result<Outcome, PipelineError> {
        let options = self.options;
        let session = without_border_keypoints(Cow::Borrowed(self.session));
        let session = &*options.at_rate(&session);
        let mut stages = progress.stages(stage_secs(options, session));
        let placed = match self.placed(session, &mut stages)? {
            ControlFlow::Break(repaired) => return Ok(repaired),
            ControlFlow::Continue(placed) => placed,
        };
        let continuation = Continuation::of(&placed, self.applied);
        let people = CorrectedPeople::default();
        let (fitted, focal_lengths) = self.finished(session, placed, &people, LAST_STAGES, &mut stages)?;
        let reconstruction = fitted.reconstruction.clone();
        let continuation = continuation.with_cameras(fitted, focal_lengths);
        if options.corrections.is_empty() {
            return Ok(Outcome::Solved(Box::new(SolvedSession { reconstruction, continuation })));
        }
        let reconstruction = self.corrected_result(session, &continuation, &mut stages)?;
        Ok(Outcome::Solved(Box::new(SolvedSession { reconstruction, continuation })))
    }

    /// The solution with corrections, from the cameras and people of the one without them.
    fn corrected(&self, continuation: &Continuation, progress: &Progress) -> Result<SolvedSession, PipelineError> {
        let session = without_border_keypoints(Cow::Borrowed(self.session));
        let session = &*self.options.at_rate(&session);
        let mut stages = progress.stages(corrected_stage_secs(self.options, session));
        let reconstruction = self.corrected_result(session, continuation, &mut stages)?;
        Ok(SolvedSession { reconstruction, continuation: continuation.clone() })
    }

    fn corrected_result(
        &self,
        session: &Session,
        continuation: &Continuation,
        stages: &mut Stages,
    ) -> Result<Reconstruction, PipelineError> {
        let (placed, people) = self.corrected_placement(session, continuation, stages)?;
        self.finished(session, placed, &people, CORRECTED_STAGES, stages).map(|(fitted, _)| fitted.reconstruction)
    }

    /// Passes 1 to 7: cameras and people, or the recording without a mistake that can be repaired.
    fn placed(&self, session: &Session, stages: &mut Stages) -> Result<ControlFlow<Outcome, Placed>, PipelineError> {
        let Self { options, checkpoints, .. } = *self;
        let known = known_mistakes(session, options);
        if let Some(repair) = self.repair(&known) {
            return Ok(ControlFlow::Break(repair));
        }
        let freedom = freedom(options);
        let last = if options.denoise { FinalAdjustment::Elsewhere } else { FinalAdjustment::Here };

        // 1. The recording as synchronous cameras would have made it.
        let timing = match options.sync {
            Sync::Given => Timing::given(session),
            Sync::Estimate => {
                let step = stages.begin("synchronisation");
                checkpoints.stage("synchronisation", || estimated_timing(session, options, last, &step))?
            }
        };
        timing.require_common_time(session)?;
        let timed = timing.applied_to(session);

        // 2. Focal lengths.
        let focal_lengths = match options.intrinsics_of(session) {
            IntrinsicsMode::Fixed => FocalLengths::given(&timed),
            IntrinsicsMode::RefineFocal => {
                let step = stages.begin("focal_lengths");
                checkpoints.stage("focal_lengths", || refined_focal_lengths(&timed, options, last, &step))?
            }
            IntrinsicsMode::Estimate => {
                let step = stages.begin("focal_lengths");
                checkpoints.stage("focal_lengths", || estimated_focal_lengths(&timed, options, last, &step))?
            }
        };
        let refined = focal_lengths.applied_to(&timed);
        let given = Capture::new(&refined, options);

        // 3. Cameras and persons.
        let step = stages.begin("cameras");
        let last = if freedom == CameraFreedom::Held { FinalAdjustment::Elsewhere } else { last };
        let calibration = checkpoints.stage("cameras", || calibrated(&given, last, &step))?;
        if calibration.n_placed() < 2 && session.views.len() > 1 {
            let mut suspicions = known;
            if !suspicions.iter().any(|suspicion| suspicion.code.affects_cameras()) {
                suspicions.extend(mistake_of_unsolved(&given, &step)?);
            }
            if let Some(repair) = self.repair(&suspicions) {
                return Ok(ControlFlow::Break(repair));
            }
            return Err(CameraEvidence::of(&given, calibration.n_placed()).error(suspicions));
        }
        self.show("cameras", &given, &calibration, &calibration.association.points);

        // 4. Repaired detections, and the cameras adjusted to them.
        let (calibration, repaired) = if options.denoise {
            let step = stages.begin("denoising");
            let denoised = checkpoints.stage("denoising", || denoised_capture(&given, calibration, freedom, &step))?;
            let (calibration, repaired) = denoised.applied_to(&refined);
            (calibration, Some(repaired))
        } else {
            (calibration, None)
        };
        let of_repaired = repaired.as_ref().map(|repaired| Capture::new(&repaired.session, options));
        let capture = of_repaired.as_ref().unwrap_or(&given);
        if of_repaired.is_some() {
            self.show("denoising", capture, &calibration, &calibration.association.points);
        }

        // 5. Cross-validation of the cameras.
        let step = stages.begin("held_out_check");
        let heldout_px = checkpoints.stage("held_out_check", || heldout_px(capture, &calibration, freedom, &step))?;

        // 6. Smooth trajectories of all keypoints.
        let step = stages.begin("joint_trajectories");
        let start = calibration.people(capture.session, &calibration.association.points);
        let paths = checkpoints.stage("joint_trajectories", || joint_trajectories(&start, &step))?;
        self.show("joint_trajectories", capture, &calibration, &paths);

        // 7. Mistakes in the files that the solution shows.
        let step = stages.begin("recording_check");
        let solved = Solved {
            given: &given,
            repaired: capture.session,
            calibration: &calibration,
            paths: &paths,
            known: &known,
        };
        let found = checkpoints.stage("recording_check", || checked(&solved, &step))?;
        if let Some(repair) = self.repair(&found) {
            return Ok(ControlFlow::Break(repair));
        }
        let (observed, repairs) = repaired.map(|r| (r.session, (r.report, r.repairs))).unzip();
        Ok(ControlFlow::Continue(Placed {
            timing,
            focal_lengths,
            calibration,
            observed,
            repairs,
            heldout_px,
            paths,
            found,
        }))
    }

    /// Cameras and people after the corrections of the options.
    fn corrected_placement(
        &self,
        session: &Session,
        continuation: &Continuation,
        stages: &mut Stages,
    ) -> Result<(Placed, CorrectedPeople), PipelineError> {
        let timed = continuation.timing().applied_to(session);
        let refined = continuation.focal_lengths().applied_to(&timed);
        let tracks = &continuation.calibration().association.tracks;
        let people = corrected_people(&refined, tracks, &self.options.corrections)?;
        require_cameras(continuation, &people)?;
        let step = stages.begin("corrections");
        let left = people.without_excluded(&refined);
        let given = Capture::new(&left, self.options);
        let corrected = self
            .checkpoints
            .stage("corrections", || corrected(&given, continuation, &people, freedom(self.options), &step))?;
        let placed = corrected.placed(&given, continuation);
        self.show("corrections", &given, &placed.calibration, &placed.paths);
        Ok((placed, people))
    }

    /// Shows cameras and points as they are known after a stage to those who watch.
    fn show(&self, stage: &'static str, capture: &Capture, calibration: &Calibration, points: &[JointTrajectory]) {
        self.watcher.show(|| {
            let (calibration, points) = (calibration.clone(), points.to_vec());
            let solution = Solution::in_world(capture, calibration, points, None, None, Vec::new());
            ProvisionalScene::new(
                stage,
                capture.session,
                solution.cameras(),
                solution.trajectories(),
                solution.up_axis(),
            )
        });
    }

    /// Passes 8 and 9: scale, world frame, bodies, statistics and verdict.
    fn finished(
        &self,
        session: &Session,
        placed: Placed,
        people: &CorrectedPeople,
        [scale_stage, bodies_stage]: [&'static str; 2],
        stages: &mut Stages,
    ) -> Result<(FittedResult, FocalLengths), PipelineError> {
        let Self { options, body, checkpoints, .. } = *self;
        let Placed { timing, mut focal_lengths, calibration, observed, repairs, heldout_px, paths, found } = placed;
        let timed = timing.applied_to(session);
        let refined = focal_lengths.applied_to(&timed);
        let capture = &Capture::new(observed.as_ref().unwrap_or(&refined), options);
        let mut suspicions = known_mistakes(session, options);
        suspicions.extend(found);
        suspicions.extend_from_slice(self.applied);

        // 8. Metres per unit.
        let step = stages.begin(scale_stage);
        let statures_at = |scale: f64| statures(capture, &calibration, &paths, scale, body, &step);
        let tracks = &calibration.association.tracks;
        let scale = checkpoints.stage(scale_stage, || {
            metric_scale::metric_scale(capture, &calibration.cameras, tracks, &paths, &people.heights, &statures_at)
        })?;

        // 9. World frame, bodies, statistics and verdict.
        let step = stages.begin(bodies_stage);
        let solution = Solution::in_world(capture, calibration, paths, scale, heldout_px, suspicions);
        let mut fitted = solution.with_bodies(capture, &mut focal_lengths, body, &step)?;
        let reconstruction = &mut fitted.reconstruction;
        (reconstruction.report.consistency, reconstruction.repairs) = repairs.unzip();
        for person in &mut reconstruction.report.people {
            person.name = people.names.get(&PersonId(person.id)).cloned();
        }
        focal_lengths.add_to(reconstruction);
        timing.add_to(session, reconstruction);
        step.report(1.0, "");
        Ok((fitted, focal_lengths))
    }
}

/// Two of the cameras that were placed must stay.
fn require_cameras(continuation: &Continuation, people: &CorrectedPeople) -> Result<(), PipelineError> {
    let cameras = continuation.calibration().cameras.iter().enumerate();
    let placed = cameras.filter(|(view, pose)| pose.is_some() && !people.excluded_views.contains(view));
    if placed.count() >= 2 || people.excluded_views.is_empty() {
        return Ok(());
    }
    let reason = "fewer than two of the cameras that could be placed would be left; leave more of them in".to_owned();
    Err(PipelineError::Option { option: "/corrections", reason })
}

fn freedom(options: &Options) -> CameraFreedom {
    match options.extrinsics {
        Extrinsics::Fixed => CameraFreedom::Held,
        Extrinsics::Estimate | Extrinsics::Refine => CameraFreedom::Adjusted,
    }
}

fn require_detections(session: &Session) -> Result<(), PipelineError> {
    if session.views.iter().any(|v| v.frames.iter().any(|people| !people.is_empty())) {
        return Ok(());
    }
    let reason = "the session holds no detection of a person in any camera; check that the keypoint files belong to this recording";
    Err(PipelineError::unsolvable("no_person_detected", reason, Vec::new()))
}
