//! Derivatives of a landmark's position by all unknowns: those of its frame and those of the border.

use super::unknowns::{Border, FrameSystem};
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::landmark_by_bones;
use crate::body::kinematics::{PosedSkeleton, landmark_by_betas};
use crate::body::model::{BodyModel, ShapeDirections};
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::Corner;
use crate::residuals::position_cost::PositionCost;
use nalgebra::{DMatrix, Matrix3, Matrix3xX, Vector3};

/// Derivatives of one landmark's position.
pub(crate) struct LandmarkJacobian {
    /// Groups of the frame that move it, ascending, and the derivatives by them.
    pub by_frame: Vec<(usize, Matrix3<f64>)>,
    pub by_border: BorderJacobian,
}

impl LandmarkJacobian {
    /// Adds a cost over the position.
    pub(crate) fn add_cost(&self, at: &PositionCost, system: &mut FrameSystem, corner: &mut Corner) {
        self.by_border.add_to_corner(&at.gradient, &at.hessian, corner);
        for (i, (row, a)) in self.by_frame.iter().enumerate() {
            let mut gradient = system.gradient.fixed_rows_mut::<3>(3 * row);
            gradient += a.tr_mul(&at.gradient);
            let left = a.tr_mul(&at.hessian);
            self.by_border.add_to_border(3 * row, &left, &mut system.border);
            for (column, b) in &self.by_frame[..=i] {
                let mut block = system.diagonal.fixed_view_mut::<3, 3>(3 * row, 3 * column);
                block += left * b;
            }
        }
    }
}

/// Derivatives of a landmark's position by the unknowns of the border: the betas in the first columns; blocks of three columns
/// (the person's bone offsets, the keypoint offset), each with its first column.
pub(crate) struct BorderJacobian {
    betas: Option<ShapeDirections>,
    blocks: Vec<(usize, Matrix3<f64>)>,
}

impl BorderJacobian {
    /// Derivatives of `landmark` with the joints in `skeleton`; `joint_directions`: of the joints by the betas, `None` where
    /// those are held.
    pub(crate) fn new(
        border: &Border,
        model: &BodyModel,
        landmark: usize,
        skeleton: &PosedSkeleton,
        joint_directions: Option<&[ShapeDirections; N_JOINTS]>,
    ) -> Self {
        let shown = &model.landmarks[landmark];
        let betas = joint_directions.map(|directions| landmark_by_betas(shown, skeleton, directions));
        let mut blocks = Vec::new();
        if let Some(table) = border.bias {
            let mut add = |column: usize, block: Matrix3<f64>| match blocks.iter_mut().find(|(c, _)| *c == column) {
                Some((_, sum)) => *sum += block,
                None => blocks.push((column, block)),
            };
            for (kind, block) in landmark_by_bones(shown, &skeleton.rotations) {
                add(border.bones().start + 3 * kind, block);
            }
            if let Some(moved) = table.of_landmark(landmark) {
                let block = skeleton.rotations[moved.joint] * moved.mirror;
                add(border.keypoint_bias().start + 3 * moved.kind, block);
            }
        }
        Self { betas, blocks }
    }

    /// As one matrix over the first `n_columns` of the border. [3, columns]
    pub(crate) fn dense(&self, n_columns: usize) -> Matrix3xX<f64> {
        let mut dense = Matrix3xX::zeros(n_columns);
        if let Some(betas) = &self.betas {
            dense.columns_mut(0, N_BETAS).copy_from(betas);
        }
        for (column, block) in &self.blocks {
            let mut target = dense.fixed_columns_mut::<3>(*column);
            target += block;
        }
        dense
    }

    /// Sum of the derivatives of one landmark in several frames, each times its factor.
    pub(crate) fn sum(parts: [(&Self, f64); 3]) -> Self {
        let [(first, _), ..] = parts;
        let betas = first.betas.map(|_| parts.iter().filter_map(|(part, factor)| Some(part.betas? * *factor)).sum());
        let block = |k: usize| parts.iter().map(|(part, factor)| part.blocks[k].1 * *factor).sum();
        let blocks = first.blocks.iter().enumerate().map(|(k, (column, _))| (*column, block(k))).collect();
        Self { betas, blocks }
    }

    /// Adds a cost over the position, given by its gradient and Hessian.
    pub(crate) fn add_to_corner(
        &self,
        by_position: &Vector3<f64>,
        position_hessian: &Matrix3<f64>,
        corner: &mut Corner,
    ) {
        let Corner { hessian, gradient } = corner;
        if let Some(betas) = &self.betas {
            let mut block = hessian.fixed_view_mut::<N_BETAS, N_BETAS>(0, 0);
            block += betas.tr_mul(&(position_hessian * betas));
            let mut gradient = gradient.fixed_rows_mut::<N_BETAS>(0);
            gradient += betas.tr_mul(by_position);
        }
        for (row, a) in &self.blocks {
            let pulled = a.tr_mul(position_hessian);
            let mut gradient = gradient.fixed_rows_mut::<3>(*row);
            gradient += a.tr_mul(by_position);
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

    /// Adds the blocks between the border and three unknowns of the frame from row `row` on; `left`: derivative by these,
    /// transposed, times the Hessian of the position.
    pub(crate) fn add_to_border(&self, row: usize, left: &Matrix3<f64>, border: &mut DMatrix<f64>) {
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
