//! What the session's detector means by its keypoints: offsets shared by everybody, found together with all motions.
//!
//! One least-squares problem over people: each person's motion, betas and bones are eliminated down to the offsets, what
//! is left of everybody is added up (an arrow of arrows). Offsets can be told from pose and shape because limbs turn: a
//! point that is off in the bone's frame goes round with the bone.

use super::evidence::Evidence;
use super::motion_problem::{DataTerm, MotionProblem, MotionState, Shape};
use super::solve::Stages;
use crate::body::BodyModel;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::{BoneOffsets, with_bones};
use crate::body::detector_offsets::{OffsetKind, OffsetTable};
use crate::optim::block_banded::{BandedStep, Eliminated, damped};
use crate::progress::Canceled;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Vector3};
use rayon::prelude::*;

/// One person's part in the estimate.
#[derive(Clone)]
pub(super) struct OffsetWitness {
    pub evidence: Evidence,
    pub state: MotionState,
    /// The person's bones against the model's; from zero on.
    pub bones: BoneOffsets,
    /// The detector's standard deviation as a share of apparent size.
    pub share: f64,
}

/// What the body's systematic misses come from. Offsets and bones can be told apart by the centres that limbs turn
/// about, but weakly one by one; all together they tell which of the two explains the session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// Nothing: neither differs from the model by more than 1 mm.
    Neither,
    /// The detector has habits; people's bones are as the betas say, to 5 mm.
    Detector,
    /// The detector means the body's joints, to a fifth of its prior; people's bones differ by 30 mm (joint centres of
    /// another definition, unusual proportions). Points of face and feet are the detector's own under either cause.
    Skeletons,
}

impl Cause {
    fn bone_sigma(self) -> f64 {
        match self {
            Self::Neither => 0.001,
            Self::Detector => 0.005,
            Self::Skeletons => 0.030,
        }
    }

    fn offset_share(self, kind: &OffsetKind) -> f64 {
        match self {
            Self::Neither if kind.is_joint => 0.02,
            Self::Skeletons if kind.is_joint => 0.2,
            _ => 1.0,
        }
    }
}

/// The offsets and how well they are known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SessionOffsets {
    /// By kind, m.
    pub offsets: Vec<Vector3<f64>>,
    /// Standard deviations, m; that of the prior where nothing was seen.
    pub sigmas: Vec<Vector3<f64>>,
    /// Cost of everything: misses, smoothness, priors.
    pub cost: f64,
    /// `log |H| / 2 - log |prior| / 2` over bones, betas and offsets.
    log_volume: f64,
    /// What was taken to be the cause.
    pub cause: Cause,
}

impl SessionOffsets {
    /// `-log p(session | cause)` by Laplace's method, but for what all causes share (MacKay 1992, Neural Computation 4:415,
    /// Eq. 2.5): cost and log volume at the optimum.
    pub(super) fn surprise(&self) -> f64 {
        self.cost / CORRELATED_FRAMES + self.log_volume
    }
}

/// A detector's error lasts about a third of a second, so that many frames at 30 Hz say as much as one: priors count
/// that many times as much against them.
const CORRELATED_FRAMES: f64 = 5.0;

/// Damped Gauss-Newton steps, and the gain in cost below which one is the last: causes are compared by it, and one unit
/// is nothing.
const MAX_ITERATIONS: usize = 7;
const MIN_GAIN: f64 = 1.0;

/// The offsets under one cause, together with everybody's motion, sought from `start` on.
///
/// # Errors
/// [`Canceled`].
pub(super) fn session_offsets(
    table: &OffsetTable,
    cause: Cause,
    start: Vec<Vector3<f64>>,
    witnesses: &mut [OffsetWitness],
    stages: &Stages,
) -> Result<SessionOffsets, Canceled> {
    let solver = Solver { table, cause, stages };
    let mut offsets = start;
    let mut sigmas = solver.prior_sigmas();
    let mut log_volume = 0.0;
    let mut cost = solver.cost(witnesses, &offsets);
    let mut damping = 1e-4;
    for _ in 0..MAX_ITERATIONS {
        stages.progress.check()?;
        let Some(reduced) = solver.reduced(witnesses, &offsets, damping) else { break };
        (sigmas, log_volume) = (reduced.sigmas(), reduced.log_volume);
        let Some(step) = reduced.solved(damping) else { break };
        let moved_offsets: Vec<Vector3<f64>> = offsets.iter().zip(&step.offsets).map(|(o, s)| o + s).collect();
        let moved = solver.moved(witnesses, &step);
        let before: Vec<(MotionState, BoneOffsets)> =
            witnesses.iter_mut().zip(moved).map(|(w, moved)| w.replaced(moved)).collect();
        let moved_cost = solver.cost(witnesses, &moved_offsets);
        if moved_cost < cost {
            let is_done = cost - moved_cost < MIN_GAIN;
            (cost, offsets, damping) = (moved_cost, moved_offsets, damping * 0.1);
            if is_done {
                break;
            }
        } else {
            witnesses.iter_mut().zip(before).for_each(|(w, before)| drop(w.replaced(before)));
            damping = (damping * 20.0).max(1e-6);
        }
    }
    Ok(SessionOffsets { offsets, sigmas, cost, log_volume, cause })
}

impl OffsetWitness {
    /// Takes another motion and skeleton; returns those it had.
    fn replaced(&mut self, (state, bones): (MotionState, BoneOffsets)) -> (MotionState, BoneOffsets) {
        (std::mem::replace(&mut self.state, state), std::mem::replace(&mut self.bones, bones))
    }

    fn bones_prior(&self, sigma: f64) -> f64 {
        0.5 * CORRELATED_FRAMES * self.bones.iter().map(|d| d.norm_squared()).sum::<f64>() / sigma.powi(2)
    }
}

struct Solver<'a> {
    table: &'a OffsetTable,
    cause: Cause,
    stages: &'a Stages<'a>,
}

/// A step of everything.
struct Step {
    offsets: Vec<Vector3<f64>>,
    motions: Vec<BandedStep>,
}

impl Solver<'_> {
    fn problem<'b>(&'b self, model: &'b BodyModel, witness: &'b OffsetWitness) -> MotionProblem<'b> {
        let data = DataTerm::Pixels { share: witness.share };
        let Stages { config, frame_interval, .. } = *self.stages;
        MotionProblem::new(model, &witness.evidence, config, data, Shape::Free, frame_interval)
            .with_free_offsets(self.table, CORRELATED_FRAMES)
    }

    fn prior_sigmas(&self) -> Vec<Vector3<f64>> {
        self.table.kinds.iter().map(|kind| kind.prior_sigma * self.cause.offset_share(kind)).collect()
    }

    fn cost(&self, witnesses: &[OffsetWitness], offsets: &[Vector3<f64>]) -> f64 {
        let model = self.table.applied(self.stages.model, offsets);
        let sigmas = self.prior_sigmas();
        let in_sigmas = offsets.iter().zip(&sigmas).map(|(offset, sigma)| offset.component_div(sigma));
        let prior: f64 = in_sigmas.map(|o| 0.5 * o.norm_squared()).sum();
        let person = |w: &OffsetWitness| {
            let own = with_bones(&model, &w.bones);
            self.problem(&own, w).cost(&w.state) + w.bones_prior(self.cause.bone_sigma())
        };
        let people: Vec<f64> = witnesses.par_iter().map(person).collect();
        people.iter().sum::<f64>() + CORRELATED_FRAMES * prior
    }

    /// The normal equations of the offsets alone.
    fn reduced(&self, witnesses: &[OffsetWitness], offsets: &[Vector3<f64>], damping: f64) -> Option<Reduced> {
        let model = self.table.applied(self.stages.model, offsets);
        let person = |w: &OffsetWitness| {
            let own = with_bones(&model, &w.bones);
            let mut system = self.problem(&own, w).linearised(&w.state).1;
            let weight = CORRELATED_FRAMES / self.cause.bone_sigma().powi(2);
            for (k, value) in w.bones.iter().flat_map(|d| d.iter()).enumerate() {
                system.corner.hessian[(N_BETAS + k, N_BETAS + k)] += weight;
                system.corner.gradient[N_BETAS + k] += weight * value;
            }
            system.eliminated(damping)
        };
        let people: Vec<Eliminated> = witnesses.par_iter().map(person).collect::<Option<_>>()?;
        let n = 3 * offsets.len();
        let (mut hessian, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (k, (sigma, offset)) in self.prior_sigmas().iter().zip(offsets).enumerate() {
            for axis in 0..3 {
                let weight = CORRELATED_FRAMES / sigma[axis].powi(2);
                hessian[(3 * k + axis, 3 * k + axis)] = weight;
                right[3 * k + axis] = -weight * offset[axis];
            }
        }
        let bone_weight = CORRELATED_FRAMES / self.cause.bone_sigma().powi(2);
        let mut log_volume = -0.5 * hessian.diagonal().iter().map(|weight| weight.ln()).sum::<f64>();
        let mut own_parts = Vec::with_capacity(people.len());
        for person in &people {
            let n_own = person.corner.nrows() - n;
            let (own, across) =
                (person.corner.view((0, 0), (n_own, n_own)), person.corner.view((0, n_own), (n_own, n)));
            let own = damped(&own.into_owned(), damping).cholesky()?;
            log_volume += half_log_det(&own) - 0.5 * (n_own - N_BETAS) as f64 * bone_weight.ln();
            let (by_offsets, rest) = (own.solve(&across), own.solve(&person.right.rows(0, n_own)));
            hessian += person.corner.view((n_own, n_own), (n, n)) - across.tr_mul(&by_offsets);
            right += person.right.rows(n_own, n) - across.tr_mul(&rest);
            own_parts.push((by_offsets, rest));
        }
        let factor = hessian.clone().cholesky()?;
        log_volume += half_log_det(&factor);
        Some(Reduced { people, own_parts, hessian, factor, right, log_volume })
    }

    fn moved(&self, witnesses: &[OffsetWitness], step: &Step) -> Vec<(MotionState, BoneOffsets)> {
        let moved = |(w, step): (&OffsetWitness, &BandedStep)| {
            let bone = |k: usize| w.bones[k] + step.border.fixed_rows::<3>(N_BETAS + 3 * k);
            (self.problem(self.stages.model, w).moved(&w.state, step), std::array::from_fn(bone))
        };
        witnesses.par_iter().zip(&step.motions).map(moved).collect()
    }
}

/// Everybody eliminated: `hessian * offsets = right`; per person `[betas, bones] = rest - by_offsets * offsets`.
struct Reduced {
    people: Vec<Eliminated>,
    own_parts: Vec<(DMatrix<f64>, DVector<f64>)>,
    hessian: DMatrix<f64>,
    /// Of the Hessian as it is, without damping.
    factor: Cholesky<f64, Dyn>,
    right: DVector<f64>,
    /// `log |H| / 2 - log |prior| / 2` over bones, betas and offsets: how much the session narrows down what the prior left
    /// open. The motions' part is the same for all causes but for little.
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
