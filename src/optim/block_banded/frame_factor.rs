//! The factor of one frame as matrices, for what follows the elimination and is not on its hot path.

use super::layout::{Layout, STRIP};
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
        let rows = |first: usize, count: usize| rows(*layout, panel, first, count);
        let later = |lag: usize| rows(layout.frame_rows(lag), if t + lag < self.n_frames() { n } else { 0 });
        let to_border = rows(layout.border_rows(), layout.n_border);
        FrameFactor { inverse: inverse_lower(&later(0)), to_next: later(1), to_after_next: later(2), to_border }
    }
}

/// Rows of a panel from `first` on, which begins a strip.
fn rows(layout: Layout, panel: &[f64], first: usize, count: usize) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(count, layout.n);
    for (column, mut values) in rows.column_iter_mut().enumerate() {
        let strips = values.as_mut_slice().chunks_mut(STRIP).enumerate();
        for (strip, values) in strips {
            let at = layout.row(first + STRIP * strip) + STRIP * column;
            values.copy_from_slice(&panel[at..at + values.len()]);
        }
    }
    rows
}

/// The inverse of a lower triangle, whose diagonal is positive; nothing above the diagonal is read.
///
/// A column of the identity is zero above its one, which solvers for any right-hand side do not use: a third of their work.
fn inverse_lower(lower: &DMatrix<f64>) -> DMatrix<f64> {
    let n = lower.nrows();
    let mut inverse = DMatrix::identity(n, n);
    for first in 0..n {
        let mut column = inverse.column_mut(first);
        let column = column.as_mut_slice();
        for k in first..n {
            let by = &lower.as_slice()[k * n..(k + 1) * n];
            column[k] /= by[k];
            let value = column[k];
            column[k + 1..].iter_mut().zip(&by[k + 1..]).for_each(|(rest, by)| *rest -= value * by);
        }
    }
    inverse
}
