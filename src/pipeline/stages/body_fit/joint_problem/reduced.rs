//! The normal equations of a session after elimination of every person's own unknowns, and its steps.

use crate::optim::block_banded::{BandedStep, BlockBanded, Corner, Eliminated, damped};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// A step of all unknowns.
pub(in super::super) struct Step {
    /// The session's: offsets, then cameras.
    pub session: DVector<f64>,
    pub motions: Vec<BandedStep>,
}

/// All persons eliminated: `hessian * free = right` with the session's unknowns `basis * free`; per person
/// `[betas, bones] = rest - by_session * session`.
pub(in super::super) struct Reduced {
    pub(super) people: Vec<Eliminated>,
    /// By person: `by_session` and `rest`.
    pub(super) own_parts: Vec<(DMatrix<f64>, DVector<f64>)>,
    /// Directions in which the session's unknowns move; `None`: in all.
    pub(super) basis: Option<DMatrix<f64>>,
    hessian: DMatrix<f64>,
    /// Of the Hessian without damping.
    pub(super) factor: Cholesky<f64, Dyn>,
    right: DVector<f64>,
}

impl Reduced {
    /// Adds up the systems of persons, each with its first `n_own` unknowns eliminated, and that of the session alone; the
    /// session's unknowns move in the directions of `basis`.
    pub(in super::super) fn new(
        people: Vec<Eliminated>,
        n_own: usize,
        session: Corner,
        basis: Option<DMatrix<f64>>,
        damping: f64,
    ) -> Option<Self> {
        let Corner { mut hessian, gradient } = session;
        let n = gradient.len();
        let mut right = -gradient;
        let mut own_parts = Vec::with_capacity(people.len());
        for person in &people {
            let (own, across) =
                (person.corner.view((0, 0), (n_own, n_own)), person.corner.view((0, n_own), (n_own, n)));
            let own = damped(&own.into_owned(), damping).cholesky()?;
            let (by_session, rest) = (own.solve(&across), own.solve(&person.right.rows(0, n_own)));
            hessian += person.corner.view((n_own, n_own), (n, n)) - across.tr_mul(&by_session);
            right += person.right.rows(n_own, n) - across.tr_mul(&rest);
            own_parts.push((by_session, rest));
        }
        if let Some(basis) = &basis {
            hessian = basis.tr_mul(&(hessian * basis));
            right = basis.tr_mul(&right);
        }
        let factor = hessian.clone().cholesky()?;
        Some(Self { people, own_parts, basis, hessian, factor, right })
    }

    /// Draws of the session's errors by its free directions. [free directions, n]
    pub(super) fn session_draws(&self, n: usize, rng: &mut ChaCha8Rng) -> Option<DMatrix<f64>> {
        draws(&self.factor, n, rng)
    }

    /// The persons' systems, for the next ones.
    pub(super) fn into_systems(self) -> Vec<BlockBanded> {
        self.people.into_iter().map(Eliminated::into_system).collect()
    }

    /// The inverse of the Hessian that has second derivatives of the robust cost, `curvature_per_weight` of the weights that the normal
    /// equations have in their place; `of_priors`: the priors' part, which is as it is.
    pub(super) fn inverse_hessian(
        &self,
        curvature_per_weight: f64,
        of_priors: Option<&DMatrix<f64>>,
    ) -> Option<DMatrix<f64>> {
        let mut hessian = &self.hessian * curvature_per_weight;
        if let Some(of_priors) = of_priors {
            hessian += of_priors * (1.0 - curvature_per_weight);
        }
        Some(hessian.cholesky()?.inverse())
    }

    /// The step under a damping; `None` where the damped system is not positive definite.
    pub(in super::super) fn solved(&self, damping: f64) -> Option<Step> {
        self.step(damped(&self.hessian, damping).cholesky()?.solve(&self.right), 1.0)
    }

    /// Minus the gradient by the free directions of the session, with the persons' own unknowns eliminated.
    pub(super) fn downhill(&self) -> &DVector<f64> {
        &self.right
    }

    /// The session moved in its free directions, and motions that follow it and go to their minimum.
    pub(super) fn stepped(&self, free: DVector<f64>) -> Option<Step> {
        self.step(free, 1.0)
    }

    /// The session moved in its free directions, and motions that follow it: those at their minimum stay at it.
    pub(super) fn followed(&self, free: DVector<f64>) -> Option<Step> {
        self.step(free, 0.0)
    }

    fn step(&self, free: DVector<f64>, own_share: f64) -> Option<Step> {
        let session = match &self.basis {
            Some(basis) => basis * free,
            None => free,
        };
        let motions =
            (0..self.people.len()).into_par_iter().map(|person| self.motion_step(person, &session, own_share));
        Some(Step { motions: motions.collect::<Option<_>>()?, session })
    }

    /// The step of a person who follows the session, with a share of what the person's own gradient asks for beside that; `None` where
    /// it is not finite.
    pub(super) fn motion_step(&self, person: usize, session: &DVector<f64>, own_share: f64) -> Option<BandedStep> {
        let (by_session, rest) = &self.own_parts[person];
        let own = rest * own_share - by_session * session;
        let border = DVector::from_iterator(own.len() + session.len(), own.iter().chain(session).copied());
        self.people[person].step(border, own_share)
    }

    /// How far the session's unknowns are from the minimum, in their standard deviations, root mean square: by the step without
    /// damping. A damped one is small where it is held back, too.
    pub(super) fn rms_sigmas(&self) -> f64 {
        self.to_minimum(&self.right).1
    }

    /// The free directions' step for minus this gradient, and its size in their standard deviations, root mean square.
    pub(super) fn to_minimum(&self, downhill: &DVector<f64>) -> (DVector<f64>, f64) {
        let free = self.factor.solve(downhill);
        let sigmas = (free.dot(downhill) / free.len().max(1) as f64).max(0.0).sqrt();
        (free, sigmas)
    }
}

/// Draws of errors whose covariance is the inverse of a Hessian `L L^T`: `L^-T w`, w white. [unknowns, n]
pub(super) fn draws(factor: &Cholesky<f64, Dyn>, n: usize, rng: &mut ChaCha8Rng) -> Option<DMatrix<f64>> {
    let white = DMatrix::from_fn(factor.l_dirty().nrows(), n, |_, _| StandardNormal.sample(rng));
    factor.l_dirty().tr_solve_lower_triangular(&white)
}
