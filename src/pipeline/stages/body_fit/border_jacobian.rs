//! Derivatives of places to what all frames share: the betas, the person's bones, the detector's offsets.

use super::motion_problem::MotionProblem;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::landmark_by_bones;
use crate::body::kinematics::{PosedSkeleton, landmark_by_betas};
use crate::body::model::ShapeDirections;
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::Corner;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Derivatives of a landmark to the unknowns of the border: the betas in the first columns; further blocks of three
/// columns (the person's bones, the detector's offset) each from a column of its own on.
pub(super) struct BorderJacobian {
    betas: Option<ShapeDirections>,
    blocks: Vec<(usize, Matrix3<f64>)>,
}

impl BorderJacobian {
    /// The same landmark's in several frames, each times its factor.
    pub(super) fn sum(parts: [(&Self, f64); 3]) -> Self {
        let [(first, _), ..] = parts;
        let betas = first.betas.map(|_| parts.iter().filter_map(|(part, factor)| Some(part.betas? * *factor)).sum());
        let block = |k: usize| parts.iter().map(|(part, factor)| part.blocks[k].1 * *factor).sum();
        let blocks = first.blocks.iter().enumerate().map(|(k, (column, _))| (*column, block(k))).collect();
        Self { betas, blocks }
    }

    /// Adds a cost over the place, given by its gradient and Hessian there.
    pub(super) fn add_to_corner(
        &self,
        place_gradient: &Vector3<f64>,
        place_hessian: &Matrix3<f64>,
        corner: &mut Corner,
    ) {
        let Corner { hessian, gradient } = corner;
        if let Some(betas) = &self.betas {
            let mut block = hessian.fixed_view_mut::<N_BETAS, N_BETAS>(0, 0);
            block += betas.tr_mul(&(place_hessian * betas));
            let mut gradient = gradient.fixed_rows_mut::<N_BETAS>(0);
            gradient += betas.tr_mul(place_gradient);
        }
        for (row, a) in &self.blocks {
            let pulled = a.tr_mul(place_hessian);
            let mut gradient = gradient.fixed_rows_mut::<3>(*row);
            gradient += a.tr_mul(place_gradient);
            for (column, b) in &self.blocks {
                let mut block = hessian.fixed_view_mut::<3, 3>(*row, *column);
                block += pulled * b;
            }
            if let Some(betas) = &self.betas {
                let crossed = pulled * betas;
                let mut block = hessian.fixed_view_mut::<3, N_BETAS>(*row, 0);
                block += crossed;
                let mut block = hessian.fixed_view_mut::<N_BETAS, 3>(0, *row);
                block += crossed.transpose();
            }
        }
    }

    /// `left`: derivative to three unknowns of the frame from row `row` on, times the Hessian of the place.
    pub(super) fn add_to_border(&self, row: usize, left: &Matrix3<f64>, border: &mut DMatrix<f64>) {
        if let Some(betas) = &self.betas {
            let mut block = border.fixed_view_mut::<3, N_BETAS>(row, 0);
            block += left * betas;
        }
        for (column, b) in &self.blocks {
            let mut block = border.fixed_view_mut::<3, 3>(row, *column);
            block += left * b;
        }
    }
}

impl MotionProblem<'_> {
    pub(super) fn by_border(
        &self,
        landmark: usize,
        skeleton: &PosedSkeleton,
        joint_directions: &[ShapeDirections; N_JOINTS],
    ) -> BorderJacobian {
        let betas = (self.n_betas() > 0)
            .then(|| landmark_by_betas(&self.model.landmarks[landmark], skeleton, joint_directions));
        let mut blocks = Vec::new();
        if let Some(table) = self.free_offsets {
            let mut add = |column: usize, block: Matrix3<f64>| match blocks.iter_mut().find(|(c, _)| *c == column) {
                Some((_, sum)) => *sum += block,
                None => blocks.push((column, block)),
            };
            for (kind, block) in landmark_by_bones(&self.model.landmarks[landmark], &skeleton.rotations) {
                add(self.n_betas() + 3 * kind, block);
            }
            if let Some(carried) = table.of_landmark(landmark) {
                let block = skeleton.rotations[carried.joint] * carried.mirror;
                add(self.first_offset() + 3 * carried.kind, block);
            }
        }
        BorderJacobian { betas, blocks }
    }
}
