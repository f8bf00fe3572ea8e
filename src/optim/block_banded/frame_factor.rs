//! The factor of one frame as matrices, for what follows the elimination and is not on its hot path.

use super::layout::STRIP;
use super::{BlockBanded, Eliminated};
use nalgebra::DMatrix;

/// Block column of the Cholesky factor `L` of a frame.
pub(super) struct FrameFactor {
    /// `L[t][t]^-1`.
    pub inverse: DMatrix<f64>,
    /// `L[t + 1][t]`; nothing in the last frame.
    pub to_next: DMatrix<f64>,
    /// `L[t + 2][t]`; nothing in the last two.
    pub to_after_next: DMatrix<f64>,
    /// `L[border][t]`.
    pub to_border: DMatrix<f64>,
}

impl Eliminated {
    pub(super) fn n_frames(&self) -> usize {
        self.factor.n_frames()
    }

    pub(super) fn frame_factor(&self, t: usize) -> FrameFactor {
        let BlockBanded { layout, panels, .. } = &self.factor;
        let (n, panel) = (layout.n, &panels[t * layout.panel_len()..(t + 1) * layout.panel_len()]);
        let rows = |first: usize, count: usize| {
            DMatrix::from_fn(count, n, |row, column| panel[layout.row(first + row) + STRIP * column])
        };
        let later = |lag: usize| rows(layout.frame_rows(lag), if t + lag < self.n_frames() { n } else { 0 });
        let mut inverse = DMatrix::identity(n, n);
        // The elimination has divided by the diagonal: none of it is zero.
        let _ = later(0).solve_lower_triangular_mut(&mut inverse);
        let to_border = rows(layout.border_rows(), layout.n_border);
        FrameFactor { inverse, to_next: later(1), to_after_next: later(2), to_border }
    }
}
