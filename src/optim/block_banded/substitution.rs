//! Back substitution: the step of each frame from those of the border and of the two frames after it.

use super::layout::{Layout, STRIP};
use nalgebra::DVector;
use pulp::{Simd, WithSimd};

/// Solves `L^T x = -(c y + F^T x_border + N^T x_next + A^T x_after)` for all frames, the last one first: `L`, `N`, `A` and `F` are
/// a panel's parts after the elimination, `y` its gradient, `c` its share.
pub(super) struct Substitution<'a> {
    pub layout: Layout,
    pub panels: &'a [f64],
    pub starts: &'a [usize],
    pub border: &'a DVector<f64>,
    /// One; zero for what the frames do because of the border alone.
    pub gradient_share: f64,
}

impl WithSimd for Substitution<'_> {
    type Output = Vec<DVector<f64>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        match S::F64_LANES {
            8 => self.run::<S, 1>(simd),
            4 => self.run::<S, 2>(simd),
            2 => self.run::<S, 4>(simd),
            _ => self.run::<S, 8>(simd),
        }
    }
}

impl Substitution<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) -> Vec<DVector<f64>> {
        let Self { layout, panels, starts, border, gradient_share } = self;
        let (n, n_strips) = (layout.n, layout.frame_strips());
        let own_rows = STRIP * n_strips;
        // What the rows of a panel are multiplied with: steps of the frame, the next, the one after it, the border; its gradient's share.
        let mut steps = vec![0.0; STRIP * layout.border_strips().end];
        let first_of_border = layout.border_rows();
        steps[first_of_border..first_of_border + layout.n_border].copy_from_slice(border.as_slice());
        steps[first_of_border + layout.n_border] = gradient_share;
        let mut sums = vec![0.0; STRIP * n];
        let mut frames: Vec<DVector<f64>> = Vec::with_capacity(panels.len() / layout.panel_len());
        for (panel, starts) in panels.chunks_exact(layout.panel_len()).zip(starts.chunks_exact(n_strips)).rev() {
            steps.copy_within(0..2 * own_rows, own_rows);
            steps[..own_rows].fill(0.0);
            sums.fill(0.0);
            for strip in n_strips..layout.border_strips().end {
                let start =
                    if (2 * n_strips..3 * n_strips).contains(&strip) { starts[strip - 2 * n_strips] } else { 0 };
                let rows = &panel[strip * layout.strip_len() + STRIP * start..(strip + 1) * layout.strip_len()];
                add_products::<S, V>(
                    simd,
                    rows,
                    &steps[STRIP * strip..STRIP * (strip + 1)],
                    &mut sums[STRIP * start..],
                );
            }
            for column in (0..n).rev() {
                let first = column / STRIP;
                let mut sum = vector::<S, V>(&sums[STRIP * column..STRIP * (column + 1)]);
                for strip in first..n_strips {
                    let at = strip * layout.strip_len() + STRIP * column;
                    let (a, x) = (vector::<S, V>(&panel[at..at + STRIP]), vector::<S, V>(&steps[STRIP * strip..]));
                    for ((sum, a), x) in sum.iter_mut().zip(a).zip(x) {
                        *sum = simd.mul_add_e_f64s(a, x, *sum);
                    }
                }
                let sum: f64 = sum.iter().map(|part| simd.reduce_sum_f64s(*part)).sum();
                steps[column] = -sum / panel[layout.row(column) + STRIP * column];
            }
            frames.push(DVector::from_column_slice(&steps[..n]));
        }
        frames.reverse();
        frames
    }
}

/// Adds the products of each column of a strip with `steps`, entry by entry.
#[inline(always)]
fn add_products<S: Simd, const V: usize>(simd: S, columns: &[f64], steps: &[f64], sums: &mut [f64]) {
    let steps = vector::<S, V>(steps);
    let columns = S::as_simd_f64s(columns).0.as_chunks::<V>().0;
    for (sum, column) in S::as_mut_simd_f64s(sums).0.as_chunks_mut::<V>().0.iter_mut().zip(columns) {
        for ((sum, a), x) in sum.iter_mut().zip(column).zip(steps) {
            *sum = simd.mul_add_e_f64s(*a, x, *sum);
        }
    }
}

/// The first eight numbers.
#[inline(always)]
fn vector<S: Simd, const V: usize>(values: &[f64]) -> [S::f64s; V] {
    S::as_simd_f64s(values).0.as_chunks::<V>().0[0]
}
