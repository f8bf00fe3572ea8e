//! The blocks of the Gauss-Newton system that belong to a single frame.

use super::unknowns::Unknowns;
use nalgebra::{DMatrix, DVector};

/// Blocks of one frame, before the time weight.
pub(crate) struct FrameSystem {
    /// Of the frame's unknowns with themselves; only the lower triangle is read.
    pub diagonal: DMatrix<f64>,
    /// Of the frame's unknowns with the border.
    pub border: DMatrix<f64>,
    pub gradient: DVector<f64>,
}

/// Added to every frame's diagonal (squared residual per rad^2 or m^2), so that a frame without observations does not make
/// the system singular: 1e6 times weaker than one keypoint.
const FLOOR: f64 = 1e-4;

impl FrameSystem {
    pub(crate) fn zeros(unknowns: &Unknowns) -> Self {
        let (n, n_border) = (3 * unknowns.n_groups(), unknowns.border.len());
        Self { diagonal: DMatrix::zeros(n, n), border: DMatrix::zeros(n, n_border), gradient: DVector::zeros(n) }
    }

    /// Adds a small constant to the diagonal.
    pub(crate) fn add_floor(&mut self) {
        for i in 0..self.diagonal.nrows() {
            self.diagonal[(i, i)] += FLOOR;
        }
    }
}
