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
//! number. The second time the border's step is known and part of the residuals, `-H_i local_step_i = J_i^T W (r_i + J_b
//! border_step)`, which needs no coupling. A block is stored densely, but zeros of its own Hessian are skipped, so the work
//! depends on the fill-in and hence on the order of the local unknowns ([`elimination_order`]); independent points and coupled
//! skeletons need no special cases. Blocks are divided into fixed portions and summed in order: the result is the same to the
//! last bit for any number of threads.

use super::vectors::vectorised;
use nalgebra::{DMatrix, DVector};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Number of portions of blocks: enough to keep every core busy, few enough to keep their sums small.
const MAX_PORTIONS: usize = 64;

/// Most numbers that the portions' sums over the border have together: 512 MB. A border of up to 1,024 unknowns has
/// [`MAX_PORTIONS`].
const MAX_SUMS: usize = 1 << 26;

/// Size of the tiles in which eliminated unknowns are subtracted from the border: 8 registers of four numbers.
const TILE_ROWS: usize = 4;
const TILE_COLUMNS: usize = 8;

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

/// How a residual of `R` components depends on `N` unknowns of a block that follow each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span<const R: usize, const N: usize> {
    /// The first of the unknowns, counted as in [`Column::index`].
    pub first: usize,
    /// Derivatives by component of the residual.
    pub derivatives: [[f64; N]; R],
}

/// The normal equations of one block: its own unknowns, and the border unknowns that it touches.
///
/// Rows over the border are padded to whole tiles with zeros. Where the step of the border is known, a block has no border: the
/// step is put into its residuals.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Block {
    n_local: usize,
    columns: Vec<usize>,
    width: usize, // length of a row over the border; 0 where its step is known
    cost: f64,
    hessian: Vec<f64>,        // [local, local], lower triangle; its Cholesky factor L after elimination
    reach: Vec<usize>,        // [local]; end of the rows with an entry in the column of an unknown
    coupling: Vec<f64>,       // [local, width]; L^-1 W after elimination
    gradient: Vec<f64>,       // [local]; L^-1 g after elimination
    border_hessian: Vec<f64>, // [width, width], lower triangle
    border_gradient: Vec<f64>, // [width]
    known_step: Option<DVector<f64>>, // of the whole border
    columns_step: Vec<f64>,   // of `columns`, where it is known
    diagonal: Vec<f64>,       // scratch: of the Hessian before elimination
    below: Vec<usize>,        // scratch: rows with an entry below the pivot
}

impl Block {
    /// A block that is reset and filled for the step of its local unknowns, given that of the whole border.
    fn with_known_step(border_step: &DVector<f64>) -> Self {
        Self { known_step: Some(border_step.clone()), ..Self::default() }
    }

    /// Empties the block for `n_local` unknowns that touch the border unknowns `columns` (distinct).
    pub fn reset(&mut self, n_local: usize, columns: &[usize]) {
        self.n_local = n_local;
        self.cost = 0.0;
        self.columns.clear();
        self.columns.extend_from_slice(columns);
        self.columns_step.clear();
        self.width = columns.len().next_multiple_of(TILE_COLUMNS);
        if let Some(step) = &self.known_step {
            self.columns_step.extend(columns.iter().map(|&column| step[column]));
            self.width = 0;
        }
        self.reach.clear();
        self.reach.extend(1..=n_local);
        for (values, length) in [
            (&mut self.hessian, n_local * n_local),
            (&mut self.coupling, n_local * self.width),
            (&mut self.gradient, n_local),
            (&mut self.border_hessian, self.width * self.width),
            (&mut self.border_gradient, self.width),
        ] {
            values.clear();
            values.resize(length, 0.0);
        }
    }

    /// Adds to the block's cost.
    #[inline(always)]
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
        let (n, m) = (self.n_local, self.width);
        let mut residual = *residual;
        let is_known = self.known_step.is_some();
        for column in border.iter().filter(|_| is_known) {
            (0..R).for_each(|k| residual[k] += column.derivative[k] * self.columns_step[column.index]);
        }
        let border = if is_known { &[] } else { border };
        for (i, a) in local.iter().enumerate() {
            let weighted = a.derivative.map(|d| weight * d);
            self.gradient[a.index] += dot(&weighted, &residual);
            for b in &local[..=i] {
                let (row, col) = (a.index.max(b.index), a.index.min(b.index));
                self.hessian[row * n + col] += dot(&weighted, &b.derivative);
                self.reach[col] = self.reach[col].max(row + 1);
            }
            for b in border {
                self.coupling[a.index * m + b.index] += dot(&weighted, &b.derivative);
            }
        }
        for (i, a) in border.iter().enumerate() {
            let weighted = a.derivative.map(|d| weight * d);
            self.border_gradient[a.index] += dot(&weighted, &residual);
            for b in &border[..=i] {
                let (row, col) = (a.index.max(b.index), a.index.min(b.index));
                self.border_hessian[row * m + col] += dot(&weighted, &b.derivative);
            }
        }
    }

    /// The same for a residual of unknowns that follow each other, in loops of fixed length.
    #[inline(always)]
    pub fn add_spans<const R: usize, const L: usize, const B: usize>(
        &mut self,
        weight: f64,
        residual: &[f64; R],
        local: &Span<R, L>,
        border: &Span<R, B>,
    ) {
        let mut residual = *residual;
        let is_known = self.known_step.is_some();
        if is_known {
            let step: &[f64] = &self.columns_step[border.first..border.first + B];
            for (value, derivatives) in residual.iter_mut().zip(&border.derivatives) {
                *value = derivatives.iter().zip(step).fold(*value, |sum, (d, s)| sum + d * s);
            }
        }
        for (k, weighted) in weighted(weight, local).iter().enumerate() {
            let row = local.first + k;
            self.gradient[row] += dot(weighted, &residual);
            add_row(&mut self.hessian[row * self.n_local + local.first..], weighted, local);
            self.reach[row] = self.reach[row].max(local.first + L);
            if !is_known {
                add_row(&mut self.coupling[row * self.width + border.first..], weighted, border);
            }
        }
        if is_known {
            return;
        }
        for (k, weighted) in weighted(weight, border).iter().enumerate() {
            let row = border.first + k;
            self.border_gradient[row] += dot(weighted, &residual);
            add_row(&mut self.border_hessian[row * self.width + border.first..], weighted, border);
        }
    }

    /// Factors `H + damping diag(H) = L L^T` and carries the coupling and the gradient along: one pass per pivot.
    #[inline(always)]
    fn eliminate(&mut self, damping: f64) {
        let (n, m) = (self.n_local, self.width);
        for k in 0..n {
            self.hessian[k * n + k] *= 1.0 + damping;
        }
        self.diagonal.clear();
        self.diagonal.extend((0..n).map(|k| self.hessian[k * n + k]));
        for k in 0..n {
            let pivot = self.hessian[k * n + k];
            // A semi-definite matrix has zeros below a zero pivot: dropping them is exact, not a repair.
            let inverse = if pivot > NO_INFORMATION * self.diagonal[k] { pivot.sqrt().recip() } else { 0.0 };
            self.hessian[k * n + k] = if inverse > 0.0 { pivot * inverse } else { 0.0 };
            self.gradient[k] *= inverse;
            self.coupling[k * m..(k + 1) * m].iter_mut().for_each(|w| *w *= inverse);
            self.below.clear();
            for i in k + 1..self.reach[k] {
                let entry = &mut self.hessian[i * n + k];
                *entry *= inverse;
                if *entry != 0.0 {
                    self.below.push(i);
                }
            }
            let (head, tail) = self.coupling.split_at_mut((k + 1) * m);
            let pivot_row = &head[k * m..];
            let end = self.reach[k];
            for (position, &i) in self.below.iter().enumerate() {
                let factor = self.hessian[i * n + k];
                self.reach[i] = self.reach[i].max(end);
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
    #[inline(always)]
    fn reduce_border<S: Simd>(&mut self, simd: S, damping: f64) {
        let m = self.width;
        if m == 0 {
            return;
        }
        for a in 0..self.columns.len() {
            self.border_hessian[a * m + a] *= 1.0 + damping;
        }
        for first_row in (0..m).step_by(TILE_ROWS) {
            for first_column in (0..first_row + TILE_ROWS).step_by(TILE_COLUMNS) {
                self.subtract_tile(simd, first_row, first_column);
            }
        }
        for (row, gradient) in self.coupling.chunks_exact(m).zip(&self.gradient) {
            self.border_gradient.iter_mut().zip(row).for_each(|(sum, w)| *sum -= w * gradient);
        }
    }

    /// Subtracts all eliminated unknowns from one tile of the border's Hessian, which stays in registers meanwhile.
    #[inline(always)]
    fn subtract_tile<S: Simd>(&mut self, simd: S, first_row: usize, first_column: usize) {
        let (m, n_vectors) = (self.width, TILE_COLUMNS / S::F64_LANES);
        let columns = first_column..first_column + TILE_COLUMNS;
        // Places for vectors of one number; longer ones leave the rest unused.
        let mut tile = [[simd.splat_f64s(0.0); TILE_COLUMNS]; TILE_ROWS];
        for coupling in self.coupling.chunks_exact(m) {
            let factors: &[f64] = &coupling[first_row..first_row + TILE_ROWS];
            let values = S::as_simd_f64s(&coupling[columns.clone()]).0;
            for (row, factor) in tile.iter_mut().zip(factors) {
                let factor = simd.splat_f64s(*factor);
                for k in 0..n_vectors {
                    row[k] = simd.mul_add_e_f64s(factor, values[k], row[k]);
                }
            }
        }
        for (row, sums) in tile.iter().enumerate() {
            let place = (first_row + row) * m + first_column;
            let entries = S::as_mut_simd_f64s(&mut self.border_hessian[place..place + TILE_COLUMNS]).0;
            for k in 0..n_vectors {
                entries[k] = simd.sub_f64s(entries[k], sums[k]);
            }
        }
    }

    /// The local step, after elimination with a known step of the border.
    fn back_substitute(&self) -> Vec<f64> {
        let n = self.n_local;
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        for k in (0..n).rev() {
            let pivot = self.hessian[k * n + k];
            let explained: f64 = (k + 1..self.reach[k]).map(|i| self.hessian[i * n + k] * step[i]).sum();
            step[k] = if pivot > 0.0 { (step[k] - explained) / pivot } else { 0.0 };
        }
        step
    }
}

/// Eliminates a block's own unknowns.
struct Elimination<'a> {
    block: &'a mut Block,
    damping: f64,
}

impl WithSimd for Elimination<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.block.eliminate(self.damping);
        self.block.reduce_border(simd, self.damping);
    }
}

/// Columns of a span times the weight: `weight * J^T`, row by row.
#[inline(always)]
fn weighted<const R: usize, const N: usize>(weight: f64, span: &Span<R, N>) -> [[f64; R]; N] {
    let mut rows = [[0.0; R]; N];
    for (k, row) in rows.iter_mut().enumerate() {
        row.iter_mut().zip(&span.derivatives).for_each(|(value, derivatives)| *value = weight * derivatives[k]);
    }
    rows
}

/// Adds `weighted^T J` to the first entries of a row.
#[inline(always)]
fn add_row<const R: usize, const N: usize>(row: &mut [f64], weighted: &[f64; R], span: &Span<R, N>) {
    for (k, entry) in row[..N].iter_mut().enumerate() {
        *entry += (0..R).fold(0.0, |sum, r| sum + weighted[r] * span.derivatives[r][k]);
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
    let partial_sums = by_portion(n_blocks, n_portions(n_border), |blocks| {
        let (mut sum, mut block) = (zero(), Block::default());
        for i in blocks {
            linearize(i, &mut block);
            vectorised(Elimination { block: &mut block, damping });
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
    total.hessian.fill_lower_triangle_with_upper_triangle();
    total
}

/// Applies `apply` to every block's cost before the step and its local step, and collects the results in order of the blocks.
///
/// `damping` and `linearize` must be those of [`reduce`].
pub fn back_substitute<T: Send>(
    n_blocks: usize,
    damping: f64,
    border_step: &DVector<f64>,
    linearize: impl Fn(usize, &mut Block) + Sync,
    apply: impl Fn(usize, f64, &[f64]) -> T + Sync,
) -> Vec<T> {
    let portions = by_portion(n_blocks, MAX_PORTIONS, |blocks| {
        let mut block = Block::with_known_step(border_step);
        let mut results = Vec::with_capacity(blocks.len());
        for i in blocks {
            linearize(i, &mut block);
            vectorised(Elimination { block: &mut block, damping });
            results.push(apply(i, block.cost, &block.back_substitute()));
        }
        results
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

/// Number of portions of which each has a sum over a border of `n_border` unknowns: by the problem's size alone, so that results
/// do not depend on the number of threads.
fn n_portions(n_border: usize) -> usize {
    (MAX_SUMS / n_border.saturating_mul(n_border).max(1)).clamp(1, MAX_PORTIONS)
}

/// Runs `work` on at most `n_portions` fixed portions of `0..n_blocks` in parallel; results in order.
fn by_portion<T: Send>(n_blocks: usize, n_portions: usize, work: impl Fn(Range<usize>) -> T + Sync) -> Vec<T> {
    let size = n_blocks.div_ceil(n_portions).max(1);
    (0..n_blocks.div_ceil(size)).into_par_iter().map(|p| work(p * size..((p + 1) * size).min(n_blocks))).collect()
}

/// Adds a block's border to the upper triangle of the sum, whose columns are contiguous.
#[inline(always)]
fn add_border(sum: &mut Reduced, block: &Block) {
    let (m, runs) = (block.width, runs(&block.columns));
    for (a, &column_a) in block.columns.iter().enumerate() {
        sum.gradient[column_a] += block.border_gradient[a];
        for run in runs.iter().take_while(|run| run.start <= a) {
            let positions = run.start..run.end.min(a + 1);
            let (first, values) = (block.columns[positions.start], &block.border_hessian[a * m..][positions]);
            if first <= column_a {
                let mut entries = sum.hessian.view_mut((first, column_a), (values.len(), 1));
                entries.iter_mut().zip(values).for_each(|(entry, value)| *entry += value);
            } else {
                let mut entries = sum.hessian.view_mut((column_a, first), (1, values.len()));
                entries.iter_mut().zip(values).for_each(|(entry, value)| *entry += value);
            }
        }
    }
    sum.cost += block.cost;
}

/// Ranges of positions at which columns follow each other.
fn runs(columns: &[usize]) -> Vec<Range<usize>> {
    let mut start = 0;
    let of_run = |run: &[usize]| {
        start += run.len();
        start - run.len()..start
    };
    columns.chunk_by(|a, b| a + 1 == *b).map(of_run).collect()
}

#[inline(always)]
fn dot<const R: usize>(a: &[f64; R], b: &[f64; R]) -> f64 {
    let mut sum = 0.0;
    for k in 0..R {
        sum += a[k] * b[k];
    }
    sum
}

#[cfg(test)]
mod tests;
