//! Arrow systems: many small local systems that are coupled only through a few shared unknowns, the border.
//!
//! ```text
//! | H_1           W_1 |        H_i: local Hessian of block i        S = B - sum_i W_i^T H_i^-1 W_i
//! |      H_2      W_2 |        W_i: its coupling to the border      S border_step = -(b - sum_i W_i^T H_i^-1 g_i)
//! |           ..   .. |        B:   Hessian of the border           local_step_i = -H_i^-1 (g_i + W_i border_step)
//! | W_1^T W_2^T .. B  |        exact elimination (Schur complement)
//! ```
//!
//! Blocks are linearised twice, to eliminate and to substitute back, and not stored: the memory does not grow with their
//! number. A block is stored densely, but zeros are skipped, so the work depends on the fill-in and hence on the order of
//! the local unknowns ([`elimination_order`]); independent points and coupled skeletons need no special cases. Blocks are
//! divided into fixed portions and summed in order: the result is the same to the last bit for any number of threads.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Number of portions of blocks: enough to keep every core busy, few enough to keep their sums small.
const MAX_PORTIONS: usize = 64;

/// Eliminated unknowns that are subtracted from the border at once; their factors fit registers.
const ROWS: usize = 4;

/// A pivot below this share of its diagonal entry is rounding error: the unknown is unobserved and does not move.
const NO_INFORMATION: f64 = 1e-13;

/// How a residual of `R` components depends on one unknown of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column<const R: usize> {
    /// Local unknown, or index in the block's list of border unknowns.
    pub index: usize,
    /// Derivative of every component of the residual.
    pub derivative: [f64; R],
}

/// The normal equations of one block: its own unknowns, and the border unknowns that it touches.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Block {
    n_local: usize,
    columns: Vec<usize>,
    cost: f64,
    hessian: Vec<f64>,        // [local, local], lower triangle; its Cholesky factor L after elimination
    coupling: Vec<f64>,       // [local, columns]; L^-1 W after elimination
    gradient: Vec<f64>,       // [local]; L^-1 g after elimination
    border_hessian: Vec<f64>, // [columns, columns], lower triangle
    border_gradient: Vec<f64>, // [columns]
    below: Vec<usize>,        // scratch: rows with an entry below the pivot
}

impl Block {
    /// Empties the block for `n_local` unknowns that touch the border unknowns `columns` (distinct).
    pub fn reset(&mut self, n_local: usize, columns: &[usize]) {
        self.n_local = n_local;
        self.cost = 0.0;
        self.columns.clear();
        self.columns.extend_from_slice(columns);
        let m = columns.len();
        for (values, length) in [
            (&mut self.hessian, n_local * n_local),
            (&mut self.coupling, n_local * m),
            (&mut self.gradient, n_local),
            (&mut self.border_hessian, m * m),
            (&mut self.border_gradient, m),
        ] {
            values.clear();
            values.resize(length, 0.0);
        }
    }

    /// Adds to the block's cost.
    pub fn add_cost(&mut self, cost: f64) {
        self.cost += cost;
    }

    /// Adds `weight * J^T J` and `weight * J^T r` of one residual; columns of `J` not listed are zero.
    pub fn add_residual<const R: usize>(
        &mut self,
        weight: f64,
        residual: &[f64; R],
        local: &[Column<R>],
        border: &[Column<R>],
    ) {
        let (n, m) = (self.n_local, self.columns.len());
        for (i, a) in local.iter().enumerate() {
            let weighted = a.derivative.map(|d| weight * d);
            self.gradient[a.index] += dot(&weighted, residual);
            for b in &local[..=i] {
                let (row, col) = (a.index.max(b.index), a.index.min(b.index));
                self.hessian[row * n + col] += dot(&weighted, &b.derivative);
            }
            for b in border {
                self.coupling[a.index * m + b.index] += dot(&weighted, &b.derivative);
            }
        }
        for (i, a) in border.iter().enumerate() {
            let weighted = a.derivative.map(|d| weight * d);
            self.border_gradient[a.index] += dot(&weighted, residual);
            for b in &border[..=i] {
                let (row, col) = (a.index.max(b.index), a.index.min(b.index));
                self.border_hessian[row * m + col] += dot(&weighted, &b.derivative);
            }
        }
    }

    /// Factors `H + damping diag(H) = L L^T` and carries the coupling and the gradient along: one pass per pivot.
    fn eliminate(&mut self, damping: f64) {
        let (n, m) = (self.n_local, self.columns.len());
        for k in 0..n {
            self.hessian[k * n + k] *= 1.0 + damping;
        }
        let diagonal: Vec<f64> = (0..n).map(|k| self.hessian[k * n + k]).collect();
        for k in 0..n {
            let pivot = self.hessian[k * n + k];
            // A semi-definite matrix has zeros below a zero pivot: dropping them is exact, not a repair.
            let inverse = if pivot > NO_INFORMATION * diagonal[k] { pivot.sqrt().recip() } else { 0.0 };
            self.hessian[k * n + k] = if inverse > 0.0 { pivot * inverse } else { 0.0 };
            self.gradient[k] *= inverse;
            self.coupling[k * m..(k + 1) * m].iter_mut().for_each(|w| *w *= inverse);
            self.below.clear();
            for i in k + 1..n {
                let entry = &mut self.hessian[i * n + k];
                *entry *= inverse;
                if *entry != 0.0 {
                    self.below.push(i);
                }
            }
            let (head, tail) = self.coupling.split_at_mut((k + 1) * m);
            let pivot_row = &head[k * m..];
            for (position, &i) in self.below.iter().enumerate() {
                let factor = self.hessian[i * n + k];
                for &j in &self.below[..=position] {
                    self.hessian[i * n + j] -= factor * self.hessian[j * n + k];
                }
                let row = &mut tail[(i - k - 1) * m..(i - k) * m];
                row.iter_mut().zip(pivot_row).for_each(|(w, p)| *w -= factor * p);
                self.gradient[i] -= factor * self.gradient[k];
            }
        }
    }

    /// Subtracts the eliminated unknowns from the border: `B - (L^-1 W)^T L^-1 W`, and its gradient likewise.
    fn reduce_border(&mut self, damping: f64) {
        let m = self.columns.len();
        for a in 0..m {
            self.border_hessian[a * m + a] *= 1.0 + damping;
        }
        let n_whole = self.n_local - self.n_local % ROWS;
        for first in (0..n_whole).step_by(ROWS) {
            self.subtract_rows::<ROWS>(first);
        }
        for row in n_whole..self.n_local {
            self.subtract_rows::<1>(row);
        }
    }

    /// Subtracts `N` rows of the eliminated unknowns, one after another in every entry: several at once read and write the border's
    /// Hessian once, and give the same bits.
    fn subtract_rows<const N: usize>(&mut self, first: usize) {
        let m = self.columns.len();
        let rows: [&[f64]; N] = std::array::from_fn(|k| &self.coupling[(first + k) * m..(first + k + 1) * m]);
        for a in 0..m {
            let factors = rows.map(|row| row[a]);
            if factors == [0.0; N] {
                continue;
            }
            let upto = rows.map(|row| &row[..=a]);
            for (j, target) in self.border_hessian[a * m..=a * m + a].iter_mut().enumerate() {
                *target = (0..N).fold(*target, |sum, k| sum - factors[k] * upto[k][j]);
            }
            let gradients = &self.gradient[first..first + N];
            self.border_gradient[a] = (0..N).fold(self.border_gradient[a], |sum, k| sum - factors[k] * gradients[k]);
        }
    }

    /// The local step, given the step of the whole border.
    fn back_substitute(&self, border_step: &DVector<f64>) -> Vec<f64> {
        let (n, m) = (self.n_local, self.columns.len());
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        for i in 0..n {
            step[i] -= (0..m).map(|a| self.coupling[i * m + a] * border_step[self.columns[a]]).sum::<f64>();
        }
        for k in (0..n).rev() {
            let pivot = self.hessian[k * n + k];
            let explained: f64 = (k + 1..n).map(|i| self.hessian[i * n + k] * step[i]).sum();
            step[k] = if pivot > 0.0 { (step[k] - explained) / pivot } else { 0.0 };
        }
        step
    }
}

/// The border's system after all local unknowns are eliminated.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduced {
    /// Schur complement S, [border, border], symmetric.
    pub hessian: DMatrix<f64>,
    /// Gradient of the cost by the border, with the local unknowns at their minimum.
    pub gradient: DVector<f64>,
    /// Cost of all blocks.
    pub cost: f64,
}

/// Linearises and eliminates every block.
///
/// `linearize(i, block)` resets the block and adds its residuals. `damping` is relative to each diagonal entry, the
/// border's included (Marquardt 1963).
pub fn reduce(n_blocks: usize, n_border: usize, damping: f64, linearize: impl Fn(usize, &mut Block) + Sync) -> Reduced {
    let zero =
        || Reduced { hessian: DMatrix::zeros(n_border, n_border), gradient: DVector::zeros(n_border), cost: 0.0 };
    let partial_sums = by_portion(n_blocks, |blocks| {
        let (mut sum, mut block) = (zero(), Block::default());
        for i in blocks {
            linearize(i, &mut block);
            block.eliminate(damping);
            block.reduce_border(damping);
            add_border(&mut sum, &block);
        }
        sum
    });
    let mut total = zero();
    for partial in partial_sums {
        total.hessian += partial.hessian;
        total.gradient += partial.gradient;
        total.cost += partial.cost;
    }
    total.hessian.fill_upper_triangle_with_lower_triangle();
    total
}

/// Applies `apply` to every block's local step and collects the results in order of the blocks.
///
/// `damping` and `linearize` must be those of [`reduce`].
pub fn back_substitute<T: Send>(
    n_blocks: usize,
    damping: f64,
    border_step: &DVector<f64>,
    linearize: impl Fn(usize, &mut Block) + Sync,
    apply: impl Fn(usize, &[f64]) -> T + Sync,
) -> Vec<T> {
    let portions = by_portion(n_blocks, |blocks| {
        let mut block = Block::default();
        blocks
            .map(|i| {
                linearize(i, &mut block);
                block.eliminate(damping);
                apply(i, &block.back_substitute(border_step))
            })
            .collect::<Vec<T>>()
    });
    portions.into_iter().flatten().collect()
}

/// An order of elimination with little fill-in: always the unknown with the fewest remaining neighbours (minimum degree,
/// Tinney and Walker 1967). A tree gets no fill-in.
///
/// `edges`: pairs of coupled unknowns below `n`; others are ignored.
pub fn elimination_order(n: usize, edges: impl IntoIterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut neighbors = vec![std::collections::BTreeSet::new(); n];
    for (a, b) in edges.into_iter().filter(|&(a, b)| a < n && b < n && a != b) {
        neighbors[a].insert(b);
        neighbors[b].insert(a);
    }
    let mut left: Vec<usize> = (0..n).collect();
    let mut order = Vec::with_capacity(n);
    while let Some(next) = left.iter().copied().min_by_key(|&v| (neighbors[v].len(), v)) {
        left.retain(|&v| v != next);
        order.push(next);
        let around = std::mem::take(&mut neighbors[next]);
        for &a in &around {
            neighbors[a].remove(&next);
            neighbors[a].extend(around.iter().filter(|&&b| b != a));
        }
    }
    order
}

/// Runs `work` on fixed portions of `0..n_blocks` in parallel; results in order.
fn by_portion<T: Send>(n_blocks: usize, work: impl Fn(std::ops::Range<usize>) -> T + Sync) -> Vec<T> {
    let size = n_blocks.div_ceil(MAX_PORTIONS).max(1);
    (0..n_blocks.div_ceil(size)).into_par_iter().map(|p| work(p * size..((p + 1) * size).min(n_blocks))).collect()
}

fn add_border(sum: &mut Reduced, block: &Block) {
    let m = block.columns.len();
    for (a, &column_a) in block.columns.iter().enumerate() {
        sum.gradient[column_a] += block.border_gradient[a];
        for (b, &column_b) in block.columns[..=a].iter().enumerate() {
            sum.hessian[(column_a.max(column_b), column_a.min(column_b))] += block.border_hessian[a * m + b];
        }
    }
    sum.cost += block.cost;
}

fn dot<const R: usize>(a: &[f64; R], b: &[f64; R]) -> f64 {
    let mut sum = 0.0;
    for k in 0..R {
        sum += a[k] * b[k];
    }
    sum
}

#[cfg(test)]
mod tests;
