//! The interface of a term: its cost, and its gradient and Gauss-Newton blocks.
//!
//! Three traits of the same form differ in what a term depends on besides the border: one frame, three successive frames, or
//! nothing.

use super::frame::{LinearisedFrame, PosedFrame};
use super::window::{LinearisedWindow, PosedWindow};
use crate::optim::block_banded::{Corner, FramePanel};

/// A term of single frames; its cost is per unit of time weight.
pub(crate) trait FrameTerm: Sync {
    /// Cost of one frame.
    fn cost(&self, frame: &PosedFrame) -> f64;

    /// Adds gradient and Gauss-Newton blocks of one frame, those of the border with itself to `corner`.
    fn add_to(&self, frame: &LinearisedFrame, system: &mut FramePanel, corner: &mut Corner);
}

/// A term of three successive frames; its cost is per unit of time weight.
pub(crate) trait WindowTerm: Sync {
    /// Cost of one window.
    fn cost(&self, window: &PosedWindow) -> f64;

    /// Adds gradient and Gauss-Newton blocks of one window to its three frames, times the time weight.
    fn add_to(&self, window: &LinearisedWindow, panels: &mut [FramePanel], corner: &mut Corner);
}

/// A quadratic term of the border alone: of unknowns of the person, or of the whole session.
pub(crate) trait BorderTerm: Sync {
    /// Cost of `values`, the unknowns that the term is about.
    fn cost(&self, values: &[f64]) -> f64;

    /// Second derivative of the cost by value `k`.
    fn precision(&self, k: usize) -> f64;

    /// Adds gradient and Hessian at `values`, the first of which has column `first` of `corner`; here those of a diagonal Hessian.
    fn add_to(&self, values: &[f64], first: usize, corner: &mut Corner) {
        for (k, value) in values.iter().enumerate() {
            let weight = self.precision(k);
            corner.hessian[(first + k, first + k)] += weight;
            corner.gradient[first + k] += weight * value;
        }
    }
}
