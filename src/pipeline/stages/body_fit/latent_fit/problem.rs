//! The objective over all persons and cameras, and its damped steps.
//!
//! The paper's `L_data + L_prior` (Eqs. 12 to 14): Geman-McClure costs of the reprojection errors, `|z|^2`, the local linear term
//! of the codes, and the prior of the betas. The gradient goes through the whole decoder. The Gauss-Newton matrix takes the
//! decoder's skip connections alone, through which a code moves its own frame and no other: with it the system stays block
//! banded, and steps, preconditioned by it, converge in some ten evaluations.

use super::super::camera_priors::CameraPriors;
use super::super::context::FitContext;
use super::super::joint_problem::Reduced;
use super::super::observations::Observations;
use super::super::session_state::SessionState;
use super::super::terms::border_priors::ShapePrior;
use super::super::terms::term::BorderTerm;
use super::super::terms::unknowns::CameraColumns;
use super::decoder::{CODE, LatentMotion, MotionDecoder, N_GROUPS};
use super::frame_system::{BorderColumns, FrameData};
use crate::body::anthropometry::N_BETAS;
use crate::body::model::{Betas, ShapedBody};
use crate::motion_prior::basis::LATENT_DIM;
use crate::motion_prior::chart::Features;
use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, FramePanel};
use crate::pipeline::calibration::PosedCamera;
use crate::progress::Canceled;
use nalgebra::{DVector, Matrix3, SVector};
use rayon::prelude::*;

/// Weight of `|z_t|^2 / 2` in a frame at 30 Hz. Codes are alike over some ten frames.
const CODE_WEIGHT: f64 = 0.1;
/// Weight of the local linear term (Eq. 11) `|z_{t+1} - 2 z_t + z_{t-1}|^2 / 2` in a frame at 30 Hz, of the order of the inverse of
/// its mean square over recorded motions, 45.
const LINEAR_WEIGHT: f64 = 30.0;
/// Added to every diagonal entry: a frame that no camera saw keeps its root.
const FLOOR: f64 = 1e-4;
/// Frames that are linearised one after another; they share one corner.
const RUN: usize = 16;
/// A step that lowers the cost by less than this share is the last.
const MIN_DECREASE: f64 = 1e-4;
/// Steps tried, the budget of a fit.
const MAX_STEPS: usize = 16;

/// One person's part.
#[derive(Clone)]
pub(super) struct Member<'a> {
    /// Their cameras are not read.
    pub observations: &'a Observations,
    /// First frame of the part in `observations`.
    pub first: usize,
    /// Standard deviation of a pixel as a share of its scale.
    pub share: f64,
    pub motion: LatentMotion,
    pub cost: f64,
}

/// The objective.
pub(super) struct LatentProblem<'a> {
    pub context: &'a FitContext<'a>,
    pub decoder: MotionDecoder<'a>,
    /// Whether the betas are unknowns.
    pub has_shape: bool,
    /// What is known of the cameras; `None`: they are held.
    pub cameras: Option<&'a CameraPriors>,
}

impl LatentProblem<'_> {
    /// Minimises from the motions of `members` and from `cameras`, which become those of the minimum; returns the steps tried.
    pub(super) fn minimised(
        &self,
        members: &mut Vec<Member>,
        cameras: &mut Vec<PosedCamera>,
    ) -> Result<usize, Canceled> {
        let (mut total, mut damping) = (self.evaluated(members, cameras), 1e-4);
        let mut systems = None;
        for tried in 1..=MAX_STEPS {
            self.context.progress.check()?;
            if self.has_shape {
                let fraction = 0.75 + 0.1 * tried as f64 / MAX_STEPS as f64;
                self.context.progress.report(fraction, "fitting latent motions and cameras together");
            }
            let current = systems.take().unwrap_or_else(|| self.systems(members, cameras));
            let moved = self.moved(members, cameras, current.clone(), damping).map(|(mut members, cameras)| {
                let total = self.evaluated(&mut members, &cameras);
                (members, cameras, total)
            });
            match moved {
                Some((better, placed, found)) if found < total => {
                    let is_done = total - found < MIN_DECREASE * total;
                    (*members, *cameras, total, damping) = (better, placed, found, damping * 0.2);
                    if is_done {
                        return Ok(tried);
                    }
                }
                _ => {
                    damping = (damping * 10.0).max(1e-3);
                    systems = Some(current);
                }
            }
        }
        Ok(MAX_STEPS)
    }

    fn columns(&self, cameras: &[PosedCamera]) -> BorderColumns {
        BorderColumns {
            n_betas: if self.has_shape { N_BETAS } else { 0 },
            n_cameras: if self.cameras.is_some() { cameras.len() } else { 0 },
        }
    }

    fn shape_prior(&self) -> ShapePrior {
        let FitContext { model, config, .. } = self.context;
        ShapePrior::new(config.shape_priors(), model)
    }

    /// Factor of a frame's cost, and that of the local linear term, whose differences are over 1/30 s.
    fn weights(&self) -> [f64; 2] {
        let frames = self.context.frame_interval * 30.0;
        [frames, frames * LINEAR_WEIGHT * frames.powi(-4)]
    }

    fn data<'b>(
        &'b self,
        member: &'b Member,
        body: &'b ShapedBody,
        cameras: &'b [PosedCamera],
        t: usize,
    ) -> FrameData<'b> {
        FrameData {
            model: self.context.model,
            body,
            cameras,
            pixels: &member.observations.pixels[member.first + t],
            share: member.share,
            robust_scale: self.context.config.robust_scale,
            time_weight: self.weights()[0],
        }
    }

    /// Writes the members' costs; returns the sum of all terms.
    fn evaluated(&self, members: &mut [Member], cameras: &[PosedCamera]) -> f64 {
        members.par_iter_mut().for_each(|member| member.cost = self.cost(member, cameras));
        let people = members.iter().map(|member| member.cost).sum::<f64>();
        people + self.cameras.map_or(0.0, |priors| priors.cost(cameras))
    }

    /// The terms of one person.
    pub(super) fn cost(&self, member: &Member, cameras: &[PosedCamera]) -> f64 {
        let LatentMotion { codes, state, .. } = &member.motion;
        let body = self.context.model.shaped(&state.betas);
        let frame = |t: usize| self.data(member, &body, cameras, t).cost(&member.motion, t);
        let data: Vec<f64> = (0..codes.len()).into_par_iter().map(frame).collect();
        let [frame_weight, linear_weight] = self.weights();
        let squares = codes.iter().flatten().map(|z| z * z).sum::<f64>();
        let bends = codes.array_windows().flat_map(|w| (0..LATENT_DIM).map(move |k| bend(w, k).powi(2))).sum::<f64>();
        data.iter().sum::<f64>()
            + 0.5 * (frame_weight * CODE_WEIGHT * squares + linear_weight * bends)
            + if self.has_shape { self.shape_prior().cost(state.betas.as_slice()) } else { 0.0 }
    }

    /// The terms of one person after a step of its motion and of its border: betas and cameras.
    #[cfg(test)]
    pub(super) fn cost_after(&self, member: &Member, cameras: &[PosedCamera], step: &BandedStep) -> f64 {
        let columns = self.cameras.map_or_else(CameraColumns::default, |priors| priors.columns(cameras.len()));
        let of_cameras = step.border.rows(N_BETAS, step.border.len() - N_BETAS).into_owned();
        let cameras =
            SessionState { offsets: Vec::new(), cameras: cameras.to_vec() }.moved(&of_cameras, columns).cameras;
        let betas = Betas::from_column_slice(&step.border.as_slice()[..N_BETAS]);
        let motion = self.decoder.moved(&member.motion, &step.frames, Some(betas));
        self.cost(&Member { motion, ..member.clone() }, &cameras)
    }

    fn systems(&self, members: &[Member], cameras: &[PosedCamera]) -> Vec<BlockBanded> {
        members.par_iter().map(|member| self.system(member, cameras)).collect()
    }

    /// The Gauss-Newton system of one person.
    pub(super) fn system(&self, member: &Member, cameras: &[PosedCamera]) -> BlockBanded {
        let (motion, columns) = (&member.motion, self.columns(cameras));
        let n_frames = motion.codes.len();
        let mut system = BlockBanded::zeros(n_frames, N_GROUPS, columns.len());
        let body = self.context.model.shaped(&motion.state.betas);
        let add_run = |(run, frames): (usize, &mut [FramePanel])| {
            let mut corner = Corner::zeros(columns.len());
            let by_features: Vec<Features> = frames
                .iter_mut()
                .enumerate()
                .map(|(i, panel)| {
                    let t = RUN * run + i;
                    panel.add_to_diagonal(FLOOR);
                    let data = self.data(member, &body, cameras, t);
                    data.add_to(&self.decoder, (motion, t), columns, panel, &mut corner)
                })
                .collect();
            (by_features, corner)
        };
        let mut frames = system.frames();
        let runs: Vec<(Vec<Features>, Corner)> = frames.par_chunks_mut(RUN).enumerate().map(add_run).collect();
        let mut by_features = Vec::with_capacity(n_frames);
        for (of_run, corner) in runs {
            by_features.extend(of_run);
            system.corner.hessian += corner.hessian;
            system.corner.gradient += corner.gradient;
        }
        if self.has_shape {
            self.shape_prior().add_to(motion.state.betas.as_slice(), 0, &mut system.corner);
        }
        for (t, by_code) in self.decoder.pulled_back(motion, &by_features).iter().enumerate() {
            system.frame(t).add_gradient(CODE, &SVector::<f64, LATENT_DIM>::from_column_slice(by_code));
        }
        self.add_code_priors(motion, &mut system);
        system
    }

    fn add_code_priors(&self, motion: &LatentMotion, system: &mut BlockBanded) {
        let [frame_weight, linear_weight] = self.weights();
        let own = Matrix3::identity() * (frame_weight * CODE_WEIGHT);
        let group = |system: &mut BlockBanded, frames: [usize; 2], block: &Matrix3<f64>| {
            (CODE / 3..N_GROUPS).for_each(|group| system.add_block(frames, [group, group], block));
        };
        for (t, code) in motion.codes.iter().enumerate() {
            group(system, [t, t], &own);
            let gradient = SVector::<f64, LATENT_DIM>::from_column_slice(code) * (frame_weight * CODE_WEIGHT);
            system.frame(t).add_gradient(CODE, &gradient);
        }
        const BEND: [f64; 3] = [1.0, -2.0, 1.0];
        for (t, window) in motion.codes.array_windows().enumerate() {
            let bends = SVector::<f64, LATENT_DIM>::from_fn(|k, _| bend(window, k)) * linear_weight;
            for (later, factor) in BEND.iter().enumerate() {
                system.frame(t + later).add_gradient(CODE, &(bends * *factor));
                for (earlier, other) in BEND.iter().enumerate().take(later + 1) {
                    let block = Matrix3::identity() * (linear_weight * factor * other);
                    group(system, [t + later, t + earlier], &block);
                }
            }
        }
    }

    /// Everything after the damped step; `None` where a system is not positive definite.
    fn moved<'b>(
        &self,
        members: &[Member<'b>],
        cameras: &[PosedCamera],
        systems: Vec<BlockBanded>,
        damping: f64,
    ) -> Option<(Vec<Member<'b>>, Vec<PosedCamera>)> {
        let (steps, of_cameras) = self.steps(cameras, systems, damping)?;
        let columns = self.cameras.map_or_else(CameraColumns::default, |priors| priors.columns(cameras.len()));
        let session = SessionState { offsets: Vec::new(), cameras: cameras.to_vec() }.moved(&of_cameras, columns);
        let move_member = |(member, step): (&Member<'b>, &BandedStep)| {
            let betas = self.has_shape.then(|| Betas::from_column_slice(&step.border.as_slice()[..N_BETAS]));
            Member { motion: self.decoder.moved(&member.motion, &step.frames, betas), ..member.clone() }
        };
        Some((members.par_iter().zip(&steps).map(move_member).collect(), session.cameras))
    }

    /// The steps of all persons, and that of the cameras.
    fn steps(
        &self,
        cameras: &[PosedCamera],
        systems: Vec<BlockBanded>,
        damping: f64,
    ) -> Option<(Vec<BandedStep>, DVector<f64>)> {
        let Some(priors) = self.cameras else {
            let steps = systems.into_par_iter().map(|mut system| system.solve(damping));
            return Some((steps.collect::<Option<_>>()?, DVector::zeros(0)));
        };
        let people = systems.into_par_iter().map(|system| system.eliminated(damping)).collect::<Option<_>>()?;
        let columns = self.columns(cameras);
        let mut session = Corner::zeros(columns.len() - columns.n_betas);
        priors.add_to(cameras, 0, &mut session);
        let step =
            Reduced::new(people, columns.n_betas, session, Some(priors.basis(0, cameras)), damping)?.solved(damping)?;
        Some((step.motions, step.session))
    }
}

/// `z_{t+1} - 2 z_t + z_{t-1}` of number `k`.
fn bend([before, here, after]: &[[f64; LATENT_DIM]; 3], k: usize) -> f64 {
    after[k] - 2.0 * here[k] + before[k]
}
