//! Derivatives of a landmark's position by all unknowns: those of its frame and those of the border.

use super::unknowns::Border;
use crate::body::anthropometry::N_BETAS;
use crate::body::bone_offsets::landmark_by_bones;
use crate::body::kinematics::{PosedSkeleton, landmark_by_betas};
use crate::body::model::{BodyModel, ShapeDirections};
use crate::body::skeleton::N_JOINTS;
use crate::optim::block_banded::{ColumnBlock, Corner, FramePanel, Strip, StripRows, append_rows};
use crate::residuals::position_cost::PositionCost;
use nalgebra::{Matrix3, Matrix3xX, SMatrix, Vector3};

/// Landmarks of one frame with derivatives, in memory that they share: a motion has too many for some of each one's own.
pub(crate) struct LinearLandmarks {
    /// World, m.
    pub positions: Vec<Vector3<f64>>,
    by_frame: Vec<ColumnBlock>,
    rows: Vec<Strip>,
    by_border: Vec<BorderJacobian>,
    /// By landmark, the end of its part of `by_frame` and of `rows`.
    ends: Vec<[usize; 2]>,
}

/// Joints of the chain that moves a landmark, on average; its strips are about as many.
const USUAL_CHAIN: usize = 6;

impl LinearLandmarks {
    /// No landmarks yet, with room for `n`.
    pub(crate) fn with_room(n: usize) -> Self {
        Self {
            positions: Vec::with_capacity(n),
            by_frame: Vec::with_capacity(USUAL_CHAIN * n),
            rows: Vec::with_capacity(USUAL_CHAIN * n),
            by_border: Vec::with_capacity(n),
            ends: Vec::with_capacity(n),
        }
    }

    /// Appends a landmark; `by_frame`: first unknowns of the groups of the frame that move it, ascending, and the derivatives by
    /// these.
    pub(crate) fn push(
        &mut self,
        position: Vector3<f64>,
        by_frame: impl Iterator<Item = ColumnBlock>,
        by_border: BorderJacobian,
    ) {
        let start = self.by_frame.len();
        self.by_frame.extend(by_frame);
        append_rows(&mut self.rows, &self.by_frame[start..]);
        self.positions.push(position);
        self.by_border.push(by_border);
        self.ends.push([self.by_frame.len(), self.rows.len()]);
    }

    /// Number of landmarks.
    pub(crate) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Derivatives of the position of landmark `index`.
    pub(crate) fn jacobian(&self, index: usize) -> LandmarkJacobian<'_> {
        let [from, first_row] = index.checked_sub(1).map_or([0; 2], |before| self.ends[before]);
        let [to, last_row] = self.ends[index];
        LandmarkJacobian {
            by_frame: &self.by_frame[from..to],
            rows: &self.rows[first_row..last_row],
            by_border: &self.by_border[index],
        }
    }
}

/// Derivatives of one landmark's position.
#[derive(Clone, Copy)]
pub(crate) struct LandmarkJacobian<'a> {
    /// First unknowns of the groups of the frame that move it, ascending, and the derivatives by these.
    pub by_frame: &'a [ColumnBlock],
    /// The same as rows of panels.
    pub rows: &'a [Strip],
    pub by_border: &'a BorderJacobian,
}

impl LandmarkJacobian<'_> {
    /// Adds a cost over the position.
    pub(crate) fn add_cost(&self, at: &PositionCost, system: &mut FramePanel, corner: &mut Corner) {
        self.by_border.add_to_corner(&at.gradient, &at.hessian, corner);
        self.add_to_frame(&at.gradient, &at.hessian, system);
        let mut across = StripRows::with_room();
        self.by_border.add_to_rows(&mut across);
        system.add_border_product(&across, &at.hessian, self.by_frame);
    }

    /// Adds a cost over the position, given by its gradient and Hessian, to what concerns the frame alone.
    pub(crate) fn add_to_frame(&self, by_position: &Vector3<f64>, hessian: &Matrix3<f64>, system: &mut FramePanel) {
        for (first, a) in self.by_frame {
            system.add_gradient(*first, &a.tr_mul(by_position));
        }
        system.add_product(0, self.rows, hessian, self.by_frame);
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
        let mut add = |column: usize, block: Matrix3<f64>| match blocks.iter_mut().find(|(c, _)| *c == column) {
            Some((_, sum)) => *sum += block,
            None => blocks.push((column, block)),
        };
        if border.has_bones {
            for (bone, block) in landmark_by_bones(shown, &skeleton.rotations) {
                add(border.bones().start + 3 * bone, block);
            }
        }
        if let Some(moved) = border.bias.and_then(|table| table.of_landmark(landmark)) {
            let block = skeleton.rotations[moved.joint] * moved.mirror;
            add(border.keypoint_bias().start + 3 * moved.kind, block);
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

    /// Sum of derivatives of one landmark, in several frames, each times its factor from the left.
    pub(crate) fn sum<'a>(parts: impl IntoIterator<Item = (Matrix3<f64>, &'a Self)>) -> Self {
        let mut sum = Self { betas: None, blocks: Vec::new() };
        for (factor, part) in parts {
            sum.betas = part.betas.map(|betas| factor * betas + sum.betas.unwrap_or_else(ShapeDirections::zeros));
            sum.blocks.extend(part.blocks.iter().skip(sum.blocks.len()).map(|(column, _)| (*column, Matrix3::zeros())));
            sum.blocks.iter_mut().zip(&part.blocks).for_each(|((_, sum), (_, block))| *sum += factor * block);
        }
        sum
    }

    /// Adds a cost over the position, given by its gradient and Hessian.
    pub(crate) fn add_to_corner(
        &self,
        by_position: &Vector3<f64>,
        position_hessian: &Matrix3<f64>,
        corner: &mut Corner,
    ) {
        self.add_gradient(by_position, corner);
        self.add_product(&Self::sum([(*position_hessian, self)]), corner);
    }

    /// Adds `B^T g` to the gradient, where `B` are these derivatives.
    pub(crate) fn add_gradient(&self, by_position: &Vector3<f64>, corner: &mut Corner) {
        if let Some(betas) = &self.betas {
            let mut gradient = corner.gradient.fixed_rows_mut::<N_BETAS>(0);
            gradient += betas.tr_mul(by_position);
        }
        for (row, a) in &self.blocks {
            let mut gradient = corner.gradient.fixed_rows_mut::<3>(*row);
            gradient += a.tr_mul(by_position);
        }
    }

    /// Adds `B^T N` to the Hessian, where `B` are these derivatives, and `N` has columns of the same unknowns.
    pub(crate) fn add_product(&self, other: &Self, corner: &mut Corner) {
        if let (Some(a), Some(b)) = (&self.betas, &other.betas) {
            let mut block = corner.hessian.fixed_view_mut::<N_BETAS, N_BETAS>(0, 0);
            block += a.tr_mul(b);
        }
        for (row, a) in &self.blocks {
            if let Some(b) = &other.betas {
                let mut block = corner.hessian.fixed_view_mut::<3, N_BETAS>(*row, 0);
                block += a.tr_mul(b);
            }
        }
        for (column, b) in &other.blocks {
            self.add_columns(*column, b, corner);
        }
    }

    /// Adds `B^T N` to columns `first` on of the Hessian.
    pub(crate) fn add_columns<const C: usize>(&self, first: usize, n: &SMatrix<f64, 3, C>, corner: &mut Corner) {
        if let Some(betas) = &self.betas {
            let mut block = corner.hessian.fixed_view_mut::<N_BETAS, C>(0, first);
            block += betas.tr_mul(n);
        }
        for (row, a) in &self.blocks {
            let mut block = corner.hessian.fixed_view_mut::<3, C>(*row, first);
            block += a.tr_mul(n);
        }
    }

    /// Adds these derivatives to rows of the border.
    pub(crate) fn add_to_rows(&self, rows: &mut StripRows) {
        if let Some(betas) = &self.betas {
            rows.add(0, betas);
        }
        self.blocks.iter().for_each(|(first, block)| rows.add(*first, block));
    }
}
