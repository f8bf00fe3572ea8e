//! Gauss-Newton systems over time: one dense block per frame, coupled over two frames, and a narrow border.
//!
//! Exact and linear in the number of frames: a block Cholesky factor `H = L L^T` of bandwidth two blocks. Each frame's
//! factor is stored as its inverse, so that most of the work is matrix products.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Half of a symmetric system `H x = -gradient` over frames of `3 * n_groups` unknowns and a border.
///
/// Most couplings between frames are within a group (a joint's acceleration involves that joint alone): [`Coupling`].
#[derive(Debug, Clone)]
pub struct BlockBanded {
    /// `H[t][t]`; only the lower triangle is read.
    pub diagonal: Vec<DMatrix<f64>>,
    /// `H[t + 1][t]`.
    pub next: Vec<Coupling>,
    /// `H[t + 2][t]`.
    pub after_next: Vec<Coupling>,
    /// `H[t][border]`.
    pub border: Vec<DMatrix<f64>>,
    /// The border's own Hessian and gradient.
    pub corner: Corner,
    /// Gradient by frame.
    pub gradient: Vec<DVector<f64>>,
}

/// The system of the border's unknowns among themselves.
#[derive(Debug, Clone)]
pub struct Corner {
    /// `H[border][border]`, full.
    pub hessian: DMatrix<f64>,
    /// Gradient of the border.
    pub gradient: DVector<f64>,
}

impl Corner {
    /// The zero system.
    pub fn zeros(n_border: usize) -> Self {
        Self { hessian: DMatrix::zeros(n_border, n_border), gradient: DVector::zeros(n_border) }
    }
}

/// A block between two frames: one 3x3 block for each group with itself, and a few between groups.
#[derive(Debug, Clone)]
pub struct Coupling {
    own: Vec<Matrix3<f64>>,
    /// Row group, column group, block; blocks of the same groups add up.
    crossed: Vec<(usize, usize, Matrix3<f64>)>,
    /// Between all groups, where a term couples many; adds to the others.
    full: Option<DMatrix<f64>>,
}

impl Coupling {
    fn zeros(n_groups: usize) -> Self {
        Self { own: vec![Matrix3::zeros(); n_groups], crossed: Vec::new(), full: None }
    }

    /// Adds a block at groups `row` of the later and `column` of the earlier frame.
    fn add(&mut self, row: usize, column: usize, block: Matrix3<f64>) {
        if row == column {
            self.own[row] += block;
        } else {
            self.crossed.push((row, column, block));
        }
    }

    fn blocks(&self) -> impl Iterator<Item = (usize, usize, &Matrix3<f64>)> {
        let own = self.own.iter().enumerate().map(|(group, block)| (group, group, block));
        own.chain(self.crossed.iter().map(|(row, column, block)| (*row, *column, block)))
    }

    fn dense(&self) -> DMatrix<f64> {
        let n = 3 * self.own.len();
        let mut dense = self.full.clone().unwrap_or_else(|| DMatrix::zeros(n, n));
        for (row, column, block) in self.blocks() {
            let mut target = dense.fixed_view_mut::<3, 3>(3 * row, 3 * column);
            target += block;
        }
        dense
    }

    /// `C L^T` of a lower triangular `L`.
    fn times_transposed(&self, lower: &DMatrix<f64>) -> DMatrix<f64> {
        let n = lower.nrows();
        if self.full.is_some() {
            return times_transposed(&self.dense(), lower);
        }
        let mut product = DMatrix::zeros(n, n);
        for (row, column, block) in self.blocks() {
            // Column c of L^T is row c of L: zero right of its diagonal.
            for c in 3 * column..n {
                let right =
                    Vector3::new(lower[(c, 3 * column)], lower[(c, 3 * column + 1)], lower[(c, 3 * column + 2)]);
                let mut target = product.fixed_view_mut::<3, 1>(3 * row, c);
                target += block * right;
            }
        }
        product
    }
}

/// The solution of a [`BlockBanded`] system.
#[derive(Debug, Clone)]
pub struct BandedStep {
    /// Step of each frame.
    pub frames: Vec<DVector<f64>>,
    /// Step of the border.
    pub border: DVector<f64>,
}

impl BlockBanded {
    /// The zero system.
    pub fn zeros(n_frames: usize, n_groups: usize, n_border: usize) -> Self {
        let n = 3 * n_groups;
        let couplings = |distance: usize| vec![Coupling::zeros(n_groups); n_frames.saturating_sub(distance)];
        Self {
            diagonal: vec![DMatrix::zeros(n, n); n_frames],
            next: couplings(1),
            after_next: couplings(2),
            border: vec![DMatrix::zeros(n, n_border); n_frames],
            corner: Corner::zeros(n_border),
            gradient: vec![DVector::zeros(n); n_frames],
        }
    }

    /// Adds a block at groups `row` of frame `later` and `column` of frame `earlier`, the same or at most two before it.
    pub fn add_block(&mut self, [later, earlier]: [usize; 2], [row, column]: [usize; 2], block: Matrix3<f64>) {
        match later - earlier {
            0 => {
                let mut target = self.diagonal[later].fixed_view_mut::<3, 3>(3 * row, 3 * column);
                target += block;
            }
            1 => self.next[earlier].add(row, column, block),
            2 => self.after_next[earlier].add(row, column, block),
            distance => unreachable!("frames {distance} apart do not couple"),
        }
    }

    /// Adds a full block between frame `later` and the frame `distance` (one or two) before it.
    pub fn add_coupling(&mut self, later: usize, distance: usize, block: DMatrix<f64>) {
        let coupling = match distance {
            1 => &mut self.next[later - 1],
            2 => &mut self.after_next[later - 2],
            _ => unreachable!("frames {distance} apart do not couple"),
        };
        match &mut coupling.full {
            Some(full) => *full += block,
            empty => *empty = Some(block),
        }
    }

    /// Solves with every diagonal entry multiplied by `1 + damping` (Marquardt 1963).
    ///
    /// Returns `None` where the damped system is not positive definite, or not finite.
    pub fn solve(&self, damping: f64) -> Option<BandedStep> {
        let eliminated = self.eliminated(damping)?;
        let mut corner = eliminated.corner.clone();
        for k in 0..corner.nrows() {
            corner[(k, k)] += damping * self.corner.hessian[(k, k)];
        }
        let border = match corner.nrows() {
            0 => DVector::zeros(0),
            _ => corner.cholesky()?.solve(&eliminated.right),
        };
        eliminated.step(border)
    }

    /// Eliminates the frames, with their diagonal multiplied by `1 + damping`; a system of the border remains.
    ///
    /// Systems that share unknowns of their borders are solved together by adding up the remaining systems.
    pub fn eliminated(&self, damping: f64) -> Option<Eliminated> {
        let n_frames = self.diagonal.len();
        let n_border = self.corner.gradient.len();
        let mut factors: Vec<FrameFactor> = Vec::with_capacity(n_frames);
        let mut corner = self.corner.hessian.clone();
        let mut corner_right = -&self.corner.gradient;
        for t in 0..n_frames {
            let mut block = damped(&self.diagonal[t], damping);
            let mut right = self.right_hand_side(t);
            let mut to_next = self.next.get(t).map(Coupling::dense);
            if let Some(one) = t.checked_sub(1).map(|i| &factors[i]) {
                subtract_square(&mut block, &one.to_next);
                right.gemm(-1.0, &one.to_next, &one.right, 1.0);
                if let Some(to_next) = &mut to_next {
                    to_next.gemm(-1.0, &one.to_after_next, &one.to_next.transpose(), 1.0);
                }
            }
            if let Some(two) = t.checked_sub(2).map(|i| &factors[i]) {
                subtract_square(&mut block, &two.to_after_next);
                right.gemm(-1.0, &two.to_after_next, &two.right, 1.0);
            }
            let inverse = inverse_of_cholesky_factor(&block)?;
            let right = &inverse * right;
            let fixed = right.columns(0, n_border);
            corner.gemm(-1.0, &fixed.transpose(), &fixed, 1.0);
            corner_right.gemv_tr(-1.0, &fixed, &right.column(n_border), 1.0);
            let empty = || DMatrix::zeros(0, block.nrows());
            factors.push(FrameFactor {
                to_next: to_next.map_or_else(empty, |c| times_transposed(&c, &inverse)),
                to_after_next: self.after_next.get(t).map_or_else(empty, |c| c.times_transposed(&inverse)),
                inverse,
                right,
            });
        }
        Some(Eliminated { factors, corner, right: corner_right })
    }

    /// `[H[t][border], -gradient]`.
    fn right_hand_side(&self, t: usize) -> DMatrix<f64> {
        let border = &self.border[t];
        let (n, n_border) = border.shape();
        let entries = border.iter().copied().chain(self.gradient[t].iter().map(|g| -g));
        DMatrix::from_iterator(n, n_border + 1, entries)
    }
}

/// A system after elimination of its frames: `corner * border = right` remains.
pub struct Eliminated {
    factors: Vec<FrameFactor>,
    /// Schur complement of the undamped corner.
    pub corner: DMatrix<f64>,
    /// Its right-hand side.
    pub right: DVector<f64>,
}

impl Eliminated {
    /// The step of all frames, given the border's; `None` where it is not finite.
    pub fn step(&self, border: DVector<f64>) -> Option<BandedStep> {
        let (n_frames, n_border) = (self.factors.len(), border.len());
        let mut frames: Vec<DVector<f64>> = vec![DVector::zeros(0); n_frames];
        for t in (0..n_frames).rev() {
            let factor = &self.factors[t];
            let mut y = factor.right.column(n_border) - factor.right.columns(0, n_border) * &border;
            if t + 1 < n_frames {
                y.gemv_tr(-1.0, &factor.to_next, &frames[t + 1], 1.0);
            }
            if t + 2 < n_frames {
                y.gemv_tr(-1.0, &factor.to_after_next, &frames[t + 2], 1.0);
            }
            frames[t] = factor.inverse.tr_mul(&y);
        }
        let is_finite = border.iter().chain(frames.iter().flat_map(|f| f.iter())).all(|v| v.is_finite());
        is_finite.then_some(BandedStep { frames, border })
    }
}

/// Factors of an eliminated frame, for the back substitution.
struct FrameFactor {
    /// `L[t][t]^-1`.
    inverse: DMatrix<f64>,
    /// `L[t + 1][t]`.
    to_next: DMatrix<f64>,
    /// `L[t + 2][t]`.
    to_after_next: DMatrix<f64>,
    /// `L^-1 [border, right-hand side]` of this frame.
    right: DMatrix<f64>,
}

/// A matrix with every diagonal entry multiplied by `1 + damping` (Marquardt 1963).
pub fn damped(block: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut block = block.clone();
    for i in 0..block.nrows() {
        block[(i, i)] *= 1.0 + damping;
    }
    block
}

/// `A - B B^T` in the lower triangle; the upper right quarter is not computed.
///
/// The transpose is a copy because nalgebra 0.35 reads past the end of strided views in small products.
fn subtract_square(target: &mut DMatrix<f64>, b: &DMatrix<f64>) {
    let (n, h) = (target.nrows(), target.nrows() / 2);
    let across = b.transpose();
    target.view_mut((0, 0), (h, h)).gemm(-1.0, &b.rows(0, h), &across.columns(0, h), 1.0);
    target.view_mut((h, 0), (n - h, n)).gemm(-1.0, &b.rows(h, n - h), &across, 1.0);
}

/// `A L^T` of a lower triangular `L`, whose upper right quarter is not read.
fn times_transposed(a: &DMatrix<f64>, lower: &DMatrix<f64>) -> DMatrix<f64> {
    let (m, n, h) = (a.nrows(), a.ncols(), a.ncols() / 2);
    let upper = lower.transpose();
    let mut product = DMatrix::zeros(m, n);
    product.columns_mut(0, h).gemm(1.0, &a.columns(0, h), &upper.view((0, 0), (h, h)), 0.0);
    product.columns_mut(h, n - h).gemm(1.0, a, &upper.columns(h, n - h), 0.0);
    product
}

/// Blocks of this size are factored entry by entry, larger ones by halves and matrix products.
const LEAF: usize = 18;

/// `L^-1` of `A = L L^T`, lower triangular; `None` if `A` is not positive definite. Reads the lower triangle of `A`.
///
/// By halves: `L21 = A21 L11^-T`, `A22 - L21 L21^T = L22 L22^T`, and the inverse is
/// `[L11^-1, 0; -L22^-1 L21 L11^-1, L22^-1]`.
fn inverse_of_cholesky_factor(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    if n <= LEAF {
        return inverse_of_small_factor(a);
    }
    let (h, rest) = (n / 2, n - n / 2);
    let first = inverse_of_cholesky_factor(&a.view((0, 0), (h, h)).into_owned())?;
    let below = times_transposed(&a.view((h, 0), (rest, h)).into_owned(), &first);
    let mut last = a.view((h, h), (rest, rest)).into_owned();
    subtract_square(&mut last, &below);
    let last = inverse_of_cholesky_factor(&last)?;
    let mut inverse = DMatrix::zeros(n, n);
    inverse.view_mut((h, 0), (rest, h)).gemm(-1.0, &last, &(below * &first), 0.0);
    inverse.view_mut((0, 0), (h, h)).copy_from(&first);
    inverse.view_mut((h, h), (rest, rest)).copy_from(&last);
    Some(inverse)
}

fn inverse_of_small_factor(a: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    let mut factor = [[0.0; LEAF]; LEAF];
    for i in 0..n {
        for j in 0..=i {
            let rest = a[(i, j)] - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
            if i == j {
                let is_positive = rest > 1e-12 * a[(i, i)].abs(); // false for NaN as well
                if !is_positive {
                    return None;
                }
                factor[i][i] = rest.sqrt();
            } else {
                factor[i][j] = rest / factor[j][j];
            }
        }
    }
    let mut inverse = DMatrix::zeros(n, n);
    for column in 0..n {
        for i in column..n {
            let unit = f64::from(u8::from(i == column));
            let rest = unit - (column..i).map(|k| factor[i][k] * inverse[(k, column)]).sum::<f64>();
            inverse[(i, column)] = rest / factor[i][i];
        }
    }
    Some(inverse)
}

mod responses;
mod selected_inverse;
#[cfg(test)]
mod tests;
