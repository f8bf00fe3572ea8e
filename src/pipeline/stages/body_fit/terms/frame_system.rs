//! The blocks of the Gauss-Newton system that belong to a single frame.

use super::unknowns::Unknowns;
use crate::optim::block_banded::Corner;
use nalgebra::{DMatrix, DVector};

/// Blocks of one frame, before the time weight.
pub(crate) struct FrameSystem<'a> {
    /// Of the frame's unknowns with themselves; only the lower triangle is read.
    pub diagonal: DMatrix<f64>,
    /// Of the frame's unknowns with the border.
    pub border: DMatrix<f64>,
    pub gradient: DVector<f64>,
    /// Of the border with itself; the frames of a run share it.
    pub corner: &'a mut Corner,
}

/// Added to every frame's diagonal (squared residual per rad^2 or m^2), so that a frame without observations does not make
/// the system singular: 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

impl<'a> FrameSystem<'a> {
    pub(crate) fn zeros(unknowns: &Unknowns, corner: &'a mut Corner) -> Self {
        let (n, n_border) = (3 * unknowns.n_groups(), unknowns.border.len());
        let (diagonal, border) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n_border));
        Self { diagonal, border, gradient: DVector::zeros(n), corner }
    }

    /// Adds a small constant to the diagonal.
    pub(crate) fn add_floor(&mut self) {
        for i in 0..self.diagonal.nrows() {
            self.diagonal[(i, i)] += FLOOR;
        }
    }
}
