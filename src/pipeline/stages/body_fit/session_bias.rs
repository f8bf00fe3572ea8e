//! Offsets of the detector's keypoints, shared by all persons and estimated together with their motions.
//!
//! One least-squares problem over all persons: each person's motion, betas and bone offsets are eliminated, and what remains
//! on the offsets is added up (an arrow of arrows). Offsets can be separated from pose and shape because limbs rotate: a point
//! that is off in the bone's frame rotates with the bone.

use super::context::FitContext;
use super::motion_problem::MotionProblem;
use super::objective::Objective;
use super::observations::Observations;
use super::terms::border_priors::{BoneLengthPrior, KeypointBiasPrior};
use super::terms::data::DataSource;
use super::terms::term::BorderTerm;
use super::terms::unknowns::{Border, MotionState, Shape};
use crate::body::BodyModel;
use crate::body::bone_offsets::{BoneOffsets, with_bones};
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::optim::block_banded::{BandedStep, Corner, Eliminated, damped};
use crate::progress::Canceled;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Vector3};
use rayon::prelude::*;

/// One person's part in the estimate.
#[derive(Clone)]
pub(super) struct BiasSample {
    pub observations: Observations,
    pub state: MotionState,
    /// The person's bones against the model's, starting at zero.
    pub bones: BoneOffsets,
    /// The detector's standard deviation as a share of apparent size.
    pub share: f64,
}

/// The source of the body's systematic residuals. Keypoint offsets and bone offsets can be separated by the centres about which
/// limbs rotate, but only weakly one by one; all together show which of the two explains the session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hypothesis {
    /// Neither differs from the model by more than 1 mm.
    NoBias,
    /// The detector has a bias; people's bones are as the betas say, to 5 mm.
    DetectorBias,
    /// The detector shows the body's joints, to a fifth of its prior; people's bones differ by 30 mm (joint centres of
    /// another definition, unusual proportions). Points of face and feet have offsets under either hypothesis.
    BodyProportions,
}

impl Hypothesis {
    fn bone_sigma(self) -> f64 {
        match self {
            Self::NoBias => 0.001,
            Self::DetectorBias => 0.005,
            Self::BodyProportions => 0.030,
        }
    }

    fn offset_share(self, kind: &OffsetKind) -> f64 {
        match self {
            Self::NoBias if kind.is_joint => 0.02,
            Self::BodyProportions if kind.is_joint => 0.2,
            _ => 1.0,
        }
    }
}

/// The offsets and their accuracy.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SessionBias {
    /// By kind, m.
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviations, m; that of the prior where nothing was observed.
    pub sigmas: Vec<Vector3<f64>>,
    /// Cost of all terms.
    pub cost: f64,
    /// `log |H| / 2 - log |prior| / 2` over bones, betas and offsets.
    log_volume: f64,
    pub hypothesis: Hypothesis,
}

impl SessionBias {
    /// `-log p(session | hypothesis)` by Laplace's method, up to a part that all hypotheses share (MacKay 1992, Neural
    /// Computation 4:415, Eq. 2.5): cost and log volume at the optimum.
    pub(super) fn negative_log_evidence(&self) -> f64 {
        self.cost / CORRELATED_FRAMES + self.log_volume
    }
}

/// A detector's error lasts about a third of a second, so that this many frames at 30 Hz carry as much information as one:
/// priors count that many times as much against them.
const CORRELATED_FRAMES: f64 = 5.0;

/// Damped Gauss-Newton steps, and the decrease of the cost below which one is the last: hypotheses are compared by the cost, and
/// one unit is negligible.
const MAX_ITERATIONS: usize = 7;
const MIN_DECREASE: f64 = 1.0;

/// The offsets under one hypothesis, estimated together with all motions, from `start`.
pub(super) fn session_bias(
    table: &OffsetTable,
    hypothesis: Hypothesis,
    start: Vec<Vector3<f64>>,
    samples: &mut [BiasSample],
    context: &FitContext,
) -> Result<SessionBias, Canceled> {
    let solver = Solver::new(table, hypothesis, context);
    let mut offsets = start;
    let mut sigmas = solver.bias_prior.sigmas.clone();
    let mut log_volume = 0.0;
    let mut cost = solver.cost(samples, &offsets);
    let mut damping = 1e-4;
    for _ in 0..MAX_ITERATIONS {
        context.progress.check()?;
        let Some(reduced) = solver.reduced(samples, &offsets, damping) else { break };
        (sigmas, log_volume) = (reduced.sigmas(), reduced.log_volume);
        let Some(step) = reduced.solved(damping) else { break };
        let moved_offsets: Vec<Vector3<f64>> = offsets.iter().zip(&step.offsets).map(|(o, s)| o + s).collect();
        let moved = solver.moved(samples, &step);
        let before: Vec<(MotionState, BoneOffsets)> =
            samples.iter_mut().zip(moved).map(|(sample, moved)| sample.replaced(moved)).collect();
        let moved_cost = solver.cost(samples, &moved_offsets);
        if moved_cost < cost {
            let is_done = cost - moved_cost < MIN_DECREASE;
            (cost, offsets, damping) = (moved_cost, moved_offsets, damping * 0.1);
            if is_done {
                break;
            }
        } else {
            samples.iter_mut().zip(before).for_each(|(sample, before)| drop(sample.replaced(before)));
            damping = (damping * 20.0).max(1e-6);
        }
    }
    Ok(SessionBias { offsets, sigmas, cost, log_volume, hypothesis })
}

impl BiasSample {
    /// Takes another motion and skeleton; returns the previous ones.
    fn replaced(&mut self, (state, bones): (MotionState, BoneOffsets)) -> (MotionState, BoneOffsets) {
        (std::mem::replace(&mut self.state, state), std::mem::replace(&mut self.bones, bones))
    }
}

/// The numbers of offsets, three each.
fn flat(offsets: &[Vector3<f64>]) -> Vec<f64> {
    offsets.iter().flat_map(|offset| offset.iter().copied()).collect()
}

struct Solver<'a> {
    table: &'a OffsetTable,
    context: &'a FitContext<'a>,
    border: Border<'a>,
    bone_prior: BoneLengthPrior,
    bias_prior: KeypointBiasPrior,
}

/// A step of all unknowns.
struct Step {
    offsets: Vec<Vector3<f64>>,
    motions: Vec<BandedStep>,
}

impl<'a> Solver<'a> {
    fn new(table: &'a OffsetTable, hypothesis: Hypothesis, context: &'a FitContext<'a>) -> Self {
        let correlated_frames = CORRELATED_FRAMES;
        let sigmas = table.kinds.iter().map(|kind| kind.prior_sigma * hypothesis.offset_share(kind)).collect();
        Self {
            table,
            context,
            border: Border { shape: Shape::Free, bias: Some(table), n_cameras: 0 },
            bone_prior: BoneLengthPrior { sigma: hypothesis.bone_sigma(), correlated_frames },
            bias_prior: KeypointBiasPrior { sigmas, correlated_frames },
        }
    }

    /// The problem of one person's motion. Its shape prior is as strong as the priors of the offsets, since offsets and shape
    /// are separated by their priors alone in what they share.
    fn problem<'b>(&'b self, model: &'b BodyModel, sample: &'b BiasSample) -> MotionProblem<'b> {
        let data = DataSource::Pixels { share: sample.share };
        let context = FitContext { model, ..*self.context };
        Objective {
            bias: Some(self.table),
            shape_prior: CORRELATED_FRAMES,
            ..Objective::new(&context, context.config, &sample.observations, data, self.border.shape)
        }
        .problem()
    }

    fn cost(&self, samples: &[BiasSample], offsets: &[Vector3<f64>]) -> f64 {
        let model = self.table.applied(self.context.model, offsets);
        let person = |sample: &BiasSample| {
            let own = with_bones(&model, &sample.bones);
            self.problem(&own, sample).cost(&sample.state) + self.bone_prior.cost(&flat(&sample.bones))
        };
        let people: Vec<f64> = samples.par_iter().map(person).collect();
        people.iter().sum::<f64>() + self.bias_prior.cost(&flat(offsets))
    }

    /// The normal equations of the session's offsets, with each person's own unknowns eliminated.
    fn reduced(&self, samples: &[BiasSample], offsets: &[Vector3<f64>], damping: f64) -> Option<Reduced> {
        let model = self.table.applied(self.context.model, offsets);
        let person = |sample: &BiasSample| {
            let own = with_bones(&model, &sample.bones);
            let mut system = self.problem(&own, sample).linearised(&sample.state);
            self.bone_prior.add_to(&flat(&sample.bones), self.border.bones().start, &mut system.corner);
            system.eliminated(damping)
        };
        let people: Vec<Eliminated> = samples.par_iter().map(person).collect::<Option<_>>()?;
        let (n_own, n) = (self.border.person().len(), self.border.session().len());
        let mut session = Corner::zeros(n);
        self.bias_prior.add_to(&flat(offsets), 0, &mut session);
        let Corner { mut hessian, gradient } = session;
        let mut right = -gradient;
        let mut log_volume = -0.5 * hessian.diagonal().iter().map(|weight| weight.ln()).sum::<f64>();
        let log_bone_prior = 0.5 * self.border.bones().len() as f64 * self.bone_prior.precision(0).ln();
        let mut own_parts = Vec::with_capacity(people.len());
        for person in &people {
            let (own, across) =
                (person.corner.view((0, 0), (n_own, n_own)), person.corner.view((0, n_own), (n_own, n)));
            let own = damped(&own.into_owned(), damping).cholesky()?;
            log_volume += half_log_det(&own) - log_bone_prior;
            let (by_offsets, rest) = (own.solve(&across), own.solve(&person.right.rows(0, n_own)));
            hessian += person.corner.view((n_own, n_own), (n, n)) - across.tr_mul(&by_offsets);
            right += person.right.rows(n_own, n) - across.tr_mul(&rest);
            own_parts.push((by_offsets, rest));
        }
        let factor = hessian.clone().cholesky()?;
        log_volume += half_log_det(&factor);
        Some(Reduced { people, own_parts, hessian, factor, right, log_volume })
    }

    fn moved(&self, samples: &[BiasSample], step: &Step) -> Vec<(MotionState, BoneOffsets)> {
        let moved = |(sample, step): (&BiasSample, &BandedStep)| {
            let bone = |k: usize| sample.bones[k] + step.border.fixed_rows::<3>(self.border.bones().start + 3 * k);
            (self.problem(self.context.model, sample).moved(&sample.state, step), std::array::from_fn(bone))
        };
        samples.par_iter().zip(&step.motions).map(moved).collect()
    }
}

/// All persons eliminated: `hessian * offsets = right`; per person `[betas, bones] = rest - by_offsets * offsets`.
struct Reduced {
    people: Vec<Eliminated>,
    own_parts: Vec<(DMatrix<f64>, DVector<f64>)>,
    hessian: DMatrix<f64>,
    /// Of the Hessian without damping.
    factor: Cholesky<f64, Dyn>,
    right: DVector<f64>,
    /// `log |H| / 2 - log |prior| / 2` over bones, betas and offsets: how much the session narrows the prior. The part of the
    /// motions is nearly the same for all hypotheses.
    log_volume: f64,
}

/// `log |A| / 2` of a matrix `A = L L^T`.
fn half_log_det(cholesky: &Cholesky<f64, Dyn>) -> f64 {
    cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum()
}

impl Reduced {
    fn solved(&self, damping: f64) -> Option<Step> {
        let offsets = damped(&self.hessian, damping).cholesky()?.solve(&self.right);
        let motion = |(person, (by_offsets, rest)): (&Eliminated, &(DMatrix<f64>, DVector<f64>))| {
            let own = rest - by_offsets * &offsets;
            let border = own.iter().chain(offsets.iter()).copied();
            person.step(DVector::from_iterator(own.len() + offsets.len(), border))
        };
        let motions = self.people.iter().zip(&self.own_parts).map(motion).collect::<Option<_>>()?;
        Some(Step { offsets: offsets.as_slice().chunks_exact(3).map(Vector3::from_column_slice).collect(), motions })
    }

    /// Standard deviations from the inverse of the reduced system, the data counted once in [`CORRELATED_FRAMES`].
    fn sigmas(&self) -> Vec<Vector3<f64>> {
        let inverse = self.factor.inverse();
        let sigma = |i: usize| (CORRELATED_FRAMES * inverse[(i, i)]).max(0.0).sqrt();
        (0..inverse.nrows() / 3).map(|k| Vector3::from_fn(|axis, _| sigma(3 * k + axis))).collect()
    }
}
