//! The inner loops of the elimination: tiles of one strip of rows by a few columns, held in registers.

use super::layout::STRIP;
use pulp::Simd;

/// `V` vectors of a strip's rows by `W` columns.
pub(super) type Tile<S, const V: usize, const W: usize> = [[<S as Simd>::f64s; V]; W];

/// Columns of one strip as a tile.
#[inline(always)]
pub(super) fn loaded<S: Simd, const V: usize, const W: usize>(simd: S, columns: &[f64]) -> Tile<S, V, W> {
    let mut tile = [[simd.splat_f64s(0.0); V]; W];
    for (column, values) in tile.iter_mut().zip(vectors::<S, V>(columns)) {
        *column = *values;
    }
    tile
}

/// Writes a tile into columns of a strip.
#[inline(always)]
pub(super) fn store<S: Simd, const V: usize, const W: usize>(tile: &Tile<S, V, W>, columns: &mut [f64]) {
    let (values, _) = S::as_mut_simd_f64s(columns);
    for (values, column) in values.as_chunks_mut::<V>().0.iter_mut().zip(tile) {
        *values = *column;
    }
}

/// `C += A B^T`: `a` are columns of a strip, `b` as many rows of `W` numbers.
#[inline(always)]
pub(super) fn add_product<S: Simd, const V: usize, const W: usize>(
    simd: S,
    tile: &mut Tile<S, V, W>,
    a: &[f64],
    b: &[f64],
) {
    let mut sum = *tile;
    for (a, b) in vectors::<S, V>(a).iter().zip(b.as_chunks::<W>().0) {
        for (column, b) in sum.iter_mut().zip(b) {
            let b = simd.splat_f64s(*b);
            for (c, a) in column.iter_mut().zip(a) {
                *c = simd.mul_add_e_f64s(*a, b, *c);
            }
        }
    }
    *tile = sum;
}

/// `C <- C L^-T`.
#[inline(always)]
pub(super) fn divide<S: Simd, const V: usize, const W: usize>(simd: S, tile: &mut Tile<S, V, W>, by: &SmallFactor<W>) {
    for j in 0..W {
        let mut column = tile[j];
        for (k, earlier) in tile.iter().enumerate().take(j) {
            let factor = simd.splat_f64s(-by.lower[j][k]);
            for (c, e) in column.iter_mut().zip(earlier) {
                *c = simd.mul_add_e_f64s(*e, factor, *c);
            }
        }
        let factor = simd.splat_f64s(by.inverse_diagonal[j]);
        tile[j] = column.map(|c| simd.mul_f64s(c, factor));
    }
}

/// Vectors of a strip, column by column.
#[inline(always)]
pub(super) fn vectors<S: Simd, const V: usize>(columns: &[f64]) -> &[[S::f64s; V]] {
    S::as_simd_f64s(columns).0.as_chunks::<V>().0
}

/// The Cholesky factor of a few columns.
pub(super) struct SmallFactor<const W: usize> {
    lower: [[f64; W]; W],
    inverse_diagonal: [f64; W],
}

/// Least pivot over its entry of the diagonal in the few columns that are given; rounding alone leaves 1e-15 of a singular one.
/// The columns before these are subtracted already: what was lost to them is not compared, only that the rest is positive.
const MIN_PIVOT: f64 = 1e-12;

impl<const W: usize> SmallFactor<W> {
    /// Of the symmetric matrix `a`, whose lower triangle is read; `None` where it is not positive definite.
    #[inline(always)]
    pub(super) fn of(a: &[[f64; W]; W]) -> Option<Self> {
        let mut lower = [[0.0; W]; W];
        let mut inverse_diagonal = [0.0; W];
        for i in 0..W {
            for j in 0..=i {
                let rest = (0..j).fold(a[i][j], |rest, k| rest - lower[i][k] * lower[j][k]);
                if i == j {
                    let is_positive = rest > MIN_PIVOT * a[i][i].abs(); // false for NaN as well
                    if !is_positive {
                        return None;
                    }
                    lower[i][i] = rest.sqrt();
                    inverse_diagonal[i] = 1.0 / lower[i][i];
                } else {
                    lower[i][j] = rest * inverse_diagonal[j];
                }
            }
        }
        Some(Self { lower, inverse_diagonal })
    }
}

/// `W` rows of panels, negated, as [`add_product`] reads them: row `first` on of the columns `from..to`.
#[inline(always)]
pub(super) fn pack_negated<const W: usize>(rows: [&[f64]; W], packed: &mut [f64]) {
    for (k, packed) in packed.as_chunks_mut::<W>().0.iter_mut().enumerate() {
        *packed = rows.map(|row| -row[STRIP * k]);
    }
}
