//! From a person's betas and bones to betas alone.
//!
//! Where the cameras are unknowns, a person's bones differ by offsets from those that the betas say; published bodies have betas alone.
//! With betas `b` and offsets `o` at a minimum, `C` its Hessian after elimination of the motion, and `D` the prior of the betas of
//! published bodies less that of the minimum, the cost of betas `b'` and no offsets is, to second order and but for a constant,
//!
//! `x^T C_bb x / 2 - x^T C_bo o + b'^T D b' / 2`, `x = b' - b`,
//!
//! and least at `b' = b + (C_bb + D)^-1 (C_bo o - D b)`.

use super::super::terms::border_priors::{BetaInformation, ShapePrior};
use super::{JointProblem, Member, SHAPE_PRIOR, flat};
use crate::body::anthropometry::N_BETAS;
use crate::body::model::Betas;
use crate::optim::block_banded::Eliminated;
use nalgebra::{DMatrix, DVector};

impl JointProblem<'_> {
    /// `person`: the member's system, eliminated near a minimum. `None` where that does not determine the betas.
    pub(super) fn betas_alone(&self, member: &Member, person: &Eliminated) -> Option<Betas> {
        let border = self.border_of(member);
        let published = ShapePrior::new(self.context.config.shape_priors(), self.context.model).hessian();
        let difference = published - BetaInformation::from_diagonal_element(SHAPE_PRIOR);
        let by_betas = person.corner.rows_range(border.betas());
        let of_betas = by_betas.fixed_columns::<N_BETAS>(border.betas().start).fixed_rows::<N_BETAS>(0).into_owned();
        let by_bones = by_betas.columns_range(border.bones()).into_owned();
        let bones = DVector::from_vec(flat(&member.bones));
        without_bones(&member.state.betas, &bones, (&of_betas, &by_bones), &difference)
    }
}

/// `b'`, with the blocks `[C_bb, C_bo]` of the Hessian and the difference `D` of the priors.
fn without_bones(
    betas: &Betas,
    bones: &DVector<f64>,
    (of_betas, by_bones): (&BetaInformation, &DMatrix<f64>),
    difference: &BetaInformation,
) -> Option<Betas> {
    let pull = Betas::from_iterator((by_bones * bones).iter().copied()) - difference * betas;
    Some(betas + (of_betas + difference).cholesky()?.solve(&pull))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic cost of betas and bones: its minimum without bones and under another prior, from its minimum with both.
    #[test]
    fn betas_say_what_they_can_of_bones() {
        let (n, n_bones) = (N_BETAS, 6);
        let root = DMatrix::from_fn(40, n + n_bones, |i, j| ((7 * i + 3 * j * j) % 11) as f64 - 5.0);
        let data = root.tr_mul(&root);
        let pull = DVector::from_fn(n + n_bones, |i, _| 30.0 - 7.0 * i as f64);
        let minimum_of = |hessian: DMatrix<f64>, pull: DVector<f64>| hessian.cholesky().unwrap().solve(&pull);
        let diagonal = |weight: f64, of_bones: f64| {
            DMatrix::from_diagonal(&DVector::from_fn(n + n_bones, |i, _| if i < n { weight } else { of_bones }))
        };
        let hessian = &data + diagonal(2.0, 50.0);
        let both = minimum_of(hessian.clone(), pull.clone());
        let of_betas = BetaInformation::from_fn(|i, j| hessian[(i, j)]);
        let by_bones = hessian.view((0, n), (n, n_bones)).into_owned();
        let difference = BetaInformation::from_diagonal_element(5.0 - 2.0);
        let betas = Betas::from_fn(|i, _| both[i]);
        let found = without_bones(&betas, &both.rows(n, n_bones).into_owned(), (&of_betas, &by_bones), &difference);
        let expected =
            minimum_of((data + diagonal(5.0, 0.0)).view((0, 0), (n, n)).into_owned(), pull.rows(0, n).into());
        assert!((found.unwrap() - Betas::from_fn(|i, _| expected[i])).norm() < 1e-9);
    }
}
