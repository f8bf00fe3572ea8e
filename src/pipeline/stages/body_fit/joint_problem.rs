//! All persons of a session as one least-squares problem: motions, shapes, what the detector adds, and the cameras.
//!
//! Each person's motion, betas and bone offsets are eliminated, and what remains on the unknowns of the whole session is
//! added up (an arrow of arrows). Cameras move in a free network: the seven directions of a similarity, which no detection
//! shows, keep their values.

mod betas_alone;
mod camera_covariance;
mod following;
mod marginal_step;
mod over_motions;
mod proportions;
mod reduced;
mod shorter_steps;

pub(super) use camera_covariance::CameraSpread;
pub(super) use proportions::{ProportionEvidence, Role};
pub(super) use reduced::Reduced;
use reduced::Step;

use super::camera_priors::CameraPriors;
use super::context::FitContext;
use super::motion_problem::MotionProblem;
use super::objective::Objective;
use super::observations::Observations;
use super::person_fit::StartedMotion;
use super::pixel_residuals::DetectedPixels;
use super::session_state::SessionState;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::noise_process::PathNoise;
use super::terms::term::BorderTerm;
use super::terms::unknowns::{Border, CameraColumns, MotionState, Shape};
use super::terms::whitened_pixels::WhitenedPixels;
use crate::body::BodyModel;
use crate::body::bone_offsets::{BoneOffsets, with_bones};
use crate::body::detector_offsets::OffsetTable;
use crate::body::model::Betas;
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, Eliminated};
use crate::pipeline::calibration::PosedCamera;
use crate::progress::Canceled;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// One person's part of the session.
#[derive(Clone)]
pub(super) struct Member {
    /// Frames of the person's track.
    pub run: Range<usize>,
    /// Every how many of them are part of the problem.
    pub stride: usize,
    /// At the frames that are, with the cameras as they stand.
    pub observations: Observations,
    pub state: MotionState,
    /// The person's bones against the model's, starting at zero.
    pub bones: BoneOffsets,
    /// Betas that say as much as they can of what betas and bones say together at the last minimum over the cameras alone.
    pub betas_alone: Option<Betas>,
}

/// The problem over all members.
pub(super) struct JointProblem<'a> {
    pub context: &'a FitContext<'a>,
    /// The kinds of keypoints whose offsets are unknowns; `None`: they are as in the context's model.
    pub table: Option<&'a OffsetTable>,
    /// The detector's errors over time.
    pub noise: &'a PathNoise,
    pub bone_prior: BoneLengthPrior,
    pub bias_prior: KeypointBiasPrior,
    /// What is known of the cameras; `None`: they are held.
    pub cameras: Option<&'a CameraPriors>,
}

/// When a minimisation ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stopping {
    /// Steps tried.
    pub max_iterations: usize,
    /// A whole step that lowers the cost by less is the last.
    pub min_decrease: f64,
    /// Where the session's unknowns are this many standard deviations from the minimum, root mean square, the step is the last.
    pub min_sigmas: f64,
}

/// The unknowns of the session at the minimum, or as near to it as the steps have led.
pub(super) struct Minimum {
    pub session: SessionState,
    costs: Costs,
}

/// What a state costs.
struct Costs {
    of_people: Vec<f64>,
    /// Of the session's unknowns alone.
    of_session: f64,
}

impl Costs {
    fn total(&self) -> f64 {
        self.of_people.iter().sum::<f64>() + self.of_session
    }
}

/// Weight of the prior of the betas. Where bones, offsets or cameras are unknowns too, betas only have to explain what these leave:
/// with the weights of the published bodies the cameras of realistic captures come up to 4 % worse.
const SHAPE_PRIOR: f64 = 1.0;

/// First damping of the diagonal. What it holds back are the directions that the session shows least, such as focal lengths with
/// distances: at 1e-4 these stopped up to two standard deviations short of the minimum (focal lengths 1.4 % off in place of 1.0 %).
const DAMPING: f64 = 1e-8;

/// Most damping under which a step counts as one to the minimum: a hundredth of that which held directions back.
const MAX_DAMPING_OF_LAST: f64 = 1e-6;

impl JointProblem<'_> {
    /// Minimises from the states of `members`, which become those of the minimum, and from `offsets`.
    pub(super) fn minimised(
        &self,
        members: &mut [Member],
        offsets: Vec<Vector3<f64>>,
        stopping: &Stopping,
    ) -> Result<Minimum, Canceled> {
        let (minimum, reduced) = self.minimised_and_reduced(members, offsets, stopping)?;
        self.context.systems.put_back(reduced.into_iter().flat_map(Reduced::into_systems));
        Ok(minimum)
    }

    /// [`Self::minimised`], with the normal equations of where the last step began, if that was short enough to be the last.
    fn minimised_and_reduced(
        &self,
        members: &mut [Member],
        offsets: Vec<Vector3<f64>>,
        stopping: &Stopping,
    ) -> Result<(Minimum, Option<Reduced>), Canceled> {
        let cameras = cameras_of(members);
        let pixels: Vec<DetectedPixels> = members.iter().map(|member| self.pixels(member)).collect();
        let session = SessionState { offsets, cameras };
        let costs = self.costs(members, &pixels, &session);
        let mut minimum = Minimum { session, costs };
        let (mut damping, mut systems) = (DAMPING, self.systems(members));
        for _ in 0..stopping.max_iterations {
            self.context.progress.check()?;
            let reduced = self.reduced((members, &pixels), &minimum.session, std::mem::take(&mut systems), damping);
            let Some(reduced) = reduced else { break };
            let Some(step) = reduced.solved(damping) else {
                systems = reduced.into_systems();
                break;
            };
            let sigmas = reduced.rms_sigmas();
            let (mut next, before) = self.stepped((members, &pixels), &minimum.session, &step);
            // Little is gained by a step that is held back, too.
            let is_whole = next.costs.total() < minimum.costs.total() && damping <= MAX_DAMPING_OF_LAST;
            if next.costs.total() >= minimum.costs.total() {
                self.shorten((members, &pixels), (&reduced, &step), (&minimum, &before), &mut next);
            }
            let decrease = minimum.costs.total() - next.costs.total();
            tracing::trace!(decrease, sigmas, damping, "step of the joint problem");
            if decrease > 0.0 {
                let is_done = is_whole && (sigmas < stopping.min_sigmas || decrease < stopping.min_decrease);
                minimum = next;
                damping *= 0.1;
                if is_done {
                    return Ok((minimum, Some(reduced)));
                }
            } else {
                replace_all(members, before, &minimum.session.cameras);
                damping = (damping * 20.0).max(1e-6);
            }
            systems = reduced.into_systems();
        }
        self.context.systems.put_back(systems);
        Ok((minimum, None))
    }

    /// Memory for the systems of all members.
    fn systems(&self, members: &[Member]) -> Vec<BlockBanded> {
        members.iter().map(|_| self.context.systems.take()).collect()
    }

    fn border(&self, n_cameras: usize) -> Border<'_> {
        Border { shape: Shape::Free, has_bones: true, bias: self.table, cameras: self.camera_columns(n_cameras) }
    }

    fn camera_columns(&self, n_cameras: usize) -> CameraColumns {
        self.cameras.map_or_else(CameraColumns::default, |priors| priors.columns(n_cameras))
    }

    fn border_of(&self, member: &Member) -> Border<'_> {
        self.border(member.observations.cameras.len())
    }

    fn pixels(&self, member: &Member) -> DetectedPixels {
        let robust_scale = self.context.config.robust_scale;
        DetectedPixels::Correlated(WhitenedPixels::new(&member.observations, self.noise, robust_scale))
    }

    /// The problem of one person's motion.
    fn problem<'b>(
        &'b self,
        model: &'b BodyModel,
        member: &'b Member,
        pixels: &'b DetectedPixels,
    ) -> MotionProblem<'b> {
        self.objective(model, member, pixels).problem()
    }

    fn objective<'b>(&'b self, model: &'b BodyModel, member: &'b Member, pixels: &'b DetectedPixels) -> Objective<'b> {
        let context = FitContext { model, ..*self.context };
        Objective {
            has_bones: true,
            bias: self.table,
            cameras: self.border_of(member).cameras,
            shape_prior: [SHAPE_PRIOR, 0.0],
            ..Objective::new(&context, context.config, &member.observations, pixels.source(), Shape::Free)
        }
    }

    /// The model with offsets of the session.
    fn model_with(&self, offsets: &[Vector3<f64>]) -> Cow<'_, BodyModel> {
        let model = self.context.model;
        self.table.map_or(Cow::Borrowed(model), |table| Cow::Owned(table.applied(model, offsets)))
    }

    fn costs(&self, members: &[Member], pixels: &[DetectedPixels], session: &SessionState) -> Costs {
        let model = self.model_with(&session.offsets);
        let person = |(member, pixels)| self.cost_of(&model, member, pixels);
        let of_people = members.par_iter().zip(pixels).map(person).collect();
        let of_cameras = self.cameras.map_or(0.0, |priors| priors.cost(&session.cameras));
        Costs { of_people, of_session: self.bias_prior.cost(&flat(&session.offsets)) + of_cameras }
    }

    /// Of one person; `model`: with the session's offsets.
    fn cost_of(&self, model: &BodyModel, member: &Member, pixels: &DetectedPixels) -> f64 {
        let own = with_bones(model, &member.bones);
        self.problem(&own, member, pixels).cost(&member.state) + self.bone_prior.cost(&flat(&member.bones))
    }

    /// The persons' systems with their motions eliminated, in the memory of `systems`.
    fn eliminated(
        &self,
        (members, pixels): (&[Member], &[DetectedPixels]),
        offsets: &[Vector3<f64>],
        systems: Vec<BlockBanded>,
        damping: f64,
    ) -> Option<Vec<Eliminated>> {
        let model = self.model_with(offsets);
        let person = |((member, pixels), mut system): ((&Member, &DetectedPixels), BlockBanded)| {
            let own = with_bones(&model, &member.bones);
            self.problem(&own, member, pixels).eliminate(&member.state, damping, &mut system)?;
            let first = self.border_of(member).bones().start;
            self.bone_prior.add_to(&flat(&member.bones), first, &mut system.corner);
            Some(system.into_eliminated())
        };
        members.par_iter().zip(pixels).zip(systems).map(person).collect()
    }

    /// The normal equations of the session's unknowns, with each person's own eliminated, in the memory of `systems`.
    fn reduced(
        &self,
        (members, pixels): (&[Member], &[DetectedPixels]),
        SessionState { offsets, cameras }: &SessionState,
        systems: Vec<BlockBanded>,
        damping: f64,
    ) -> Option<Reduced> {
        let people = self.eliminated((members, pixels), offsets, systems, damping)?;
        let border = self.border(cameras.len());
        let n_own = border.person().len();
        let mut session = Corner::zeros(border.session().len());
        self.bias_prior.add_to(&flat(offsets), 0, &mut session);
        if let Some(priors) = self.cameras {
            priors.add_to(cameras, border.keypoint_bias().len(), &mut session);
        }
        let basis = self.cameras.map(|priors| priors.basis(3 * offsets.len(), cameras));
        Reduced::new(people, n_own, session, basis, damping)
    }

    /// Moves `members` by a step. Returns the session after it with its cost, and what the members were before.
    fn stepped(
        &self,
        (members, pixels): (&mut [Member], &[DetectedPixels]),
        session: &SessionState,
        step: &Step,
    ) -> (Minimum, Vec<MotionAndBones>) {
        let session = session.moved(&step.session, self.camera_columns(session.cameras.len()));
        let moved = |((member, pixels), step): ((&Member, &DetectedPixels), &BandedStep)| {
            self.moved(member, pixels, (&member.state, &member.bones), step)
        };
        let moved = members.par_iter().zip(pixels).zip(&step.motions).map(moved).collect();
        let before = replace_all(members, moved, &session.cameras);
        let costs = self.costs(members, pixels, &session);
        (Minimum { session, costs }, before)
    }

    /// A person's motion and skeleton after a step from these.
    fn moved(
        &self,
        member: &Member,
        pixels: &DetectedPixels,
        (state, bones): (&MotionState, &BoneOffsets),
        step: &BandedStep,
    ) -> MotionAndBones {
        let first = self.border_of(member).bones().start;
        let bone = |k: usize| bones[k] + step.border.fixed_rows::<3>(first + 3 * k);
        let unknowns = self.objective(self.context.model, member, pixels).unknowns();
        (unknowns.moved(state, step), std::array::from_fn(bone))
    }
}

impl Member {
    /// Every `stride`-th frame of a run of the track, as detected.
    pub(super) fn of(observations: &Observations, started: &StartedMotion, run: Range<usize>, stride: usize) -> Self {
        Self::new(observations.thinned(run.clone(), stride), started, run, stride)
    }

    /// The same; `observations`: at these frames.
    pub(super) fn new(observations: Observations, started: &StartedMotion, run: Range<usize>, stride: usize) -> Self {
        let state = started.fitted.state.thinned(run.clone(), stride);
        Self { run, stride, observations, state, bones: BoneOffsets::default(), betas_alone: None }
    }

    /// Takes another motion, skeleton and cameras; returns the previous motion and skeleton.
    fn replaced(&mut self, (state, bones): MotionAndBones, cameras: &[PosedCamera]) -> MotionAndBones {
        self.observations.cameras.copy_from_slice(cameras);
        (std::mem::replace(&mut self.state, state), std::mem::replace(&mut self.bones, bones))
    }
}

/// The cameras as they stand.
fn cameras_of(members: &[Member]) -> Vec<PosedCamera> {
    members.first().map_or_else(Vec::new, |member| member.observations.cameras.clone())
}

/// What a step changes of a member besides the cameras.
type MotionAndBones = (MotionState, BoneOffsets);

/// Gives every member another motion, skeleton and cameras; returns the previous motions and skeletons.
fn replace_all(members: &mut [Member], by: Vec<MotionAndBones>, cameras: &[PosedCamera]) -> Vec<MotionAndBones> {
    members.iter_mut().zip(by).map(|(member, by)| member.replaced(by, cameras)).collect()
}

/// The numbers of offsets, three each.
pub(super) fn flat(offsets: &[Vector3<f64>]) -> Vec<f64> {
    offsets.iter().flat_map(|offset| offset.iter().copied()).collect()
}
