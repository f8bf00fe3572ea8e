//! Squares of derivatives added to panels: what a point's position asks of the unknowns that move it.
//!
//! A point depends on a few groups of unknowns, spread over many strips. Whole strips are added at once, zeros among them, since
//! eight numbers in a row are added as fast as three that lie apart.

use super::kernel::vectors;
use super::layout::{FramePanel, STRIP};
use crate::optim::vectors::vectorised;
use nalgebra::{Matrix3, SMatrix};
use pulp::{Simd, WithSimd};
use std::ops::Deref;

/// Derivatives of a point by as many unknowns as a strip of a panel has rows: its number, and x, y and z by each.
pub type Strip = (usize, [[f64; STRIP]; 3]);

/// Derivatives of a point by unknowns of the border, `R`, in strips as panels have their rows.
#[derive(Debug, Clone)]
pub struct StripRows {
    /// Strips that are not zero, ascending.
    strips: Vec<Strip>,
}

/// Derivatives by three successive unknowns: the first of them, and the block.
pub type ColumnBlock = (usize, Matrix3<f64>);

/// Strips of a border with bones and five cameras.
const EXPECTED_STRIPS: usize = 9;

/// Blocks that are multiplied together; a chain of joints has fewer.
const MAX_BLOCKS: usize = 12;

impl StripRows {
    /// No rows yet, with room for those of a border.
    pub fn with_room() -> Self {
        Self { strips: Vec::with_capacity(EXPECTED_STRIPS) }
    }

    /// Takes all rows away.
    pub fn clear(&mut self) {
        self.strips.clear();
    }

    /// Adds the derivatives by the unknowns from `first` on.
    pub fn add<const C: usize>(&mut self, first: usize, derivatives: &SMatrix<f64, 3, C>) {
        add_rows(&mut self.strips, 0, first, derivatives);
    }
}

impl Deref for StripRows {
    type Target = [Strip];

    fn deref(&self) -> &[Strip] {
        &self.strips
    }
}

/// Appends a point's derivatives by the unknowns of its frame to the strips of other points.
pub fn append_rows(strips: &mut Vec<Strip>, blocks: &[ColumnBlock]) {
    let start = strips.len();
    blocks.iter().for_each(|(first, derivatives)| add_rows(strips, start, *first, derivatives));
}

/// Adds derivatives by the unknowns from `first` on to the strips of a point, which are those from `start` on.
fn add_rows<const C: usize>(strips: &mut Vec<Strip>, start: usize, first: usize, derivatives: &SMatrix<f64, 3, C>) {
    for (k, column) in derivatives.column_iter().enumerate() {
        let strip = strip_of(strips, start, (first + k) / STRIP);
        for (values, derivative) in strip.iter_mut().zip(&column) {
            values[(first + k) % STRIP] += derivative;
        }
    }
}

fn strip_of(strips: &mut Vec<Strip>, start: usize, strip: usize) -> &mut [[f64; STRIP]; 3] {
    // Mostly the last one, since unknowns are ascending.
    let is_before = |(known, _): &Strip| *known < strip;
    let place = strips[start..].iter().rposition(is_before).map_or(start, |before| start + before + 1);
    if strips.get(place).is_none_or(|(known, _)| *known != strip) {
        strips.insert(place, (strip, [[0.0; STRIP]; 3]));
    }
    &mut strips[place].1
}

impl FramePanel<'_> {
    /// Adds `R^T M C` to `H[t + lag][t]`: `rows` are derivatives by the later frame, `columns` by this one, and `M` is the second
    /// derivative by the positions. `lag`: at most two; with 0 only what the lower triangle needs.
    pub fn add_product(&mut self, lag: usize, rows: &[Strip], by_positions: &Matrix3<f64>, columns: &[ColumnBlock]) {
        if lag == 2 {
            let first = columns.iter().map(|(first, _)| *first).min().unwrap_or(self.layout.n);
            rows.iter().for_each(|(strip, _)| self.starts[*strip] = first.min(self.starts[*strip]));
        }
        self.add_strips(lag * self.layout.frame_strips(), lag == 0, (rows, by_positions, columns));
    }

    /// The same for `H[border][t]`.
    pub fn add_border_product(&mut self, rows: &[Strip], by_positions: &Matrix3<f64>, columns: &[ColumnBlock]) {
        self.add_strips(self.layout.border_strips().start, false, (rows, by_positions, columns));
    }

    fn add_strips(&mut self, first_strip: usize, is_lower: bool, factors: (&[Strip], &Matrix3<f64>, &[ColumnBlock])) {
        let strip_len = self.layout.strip_len();
        let (rows, by_positions, columns) = factors;
        for columns in columns.chunks(MAX_BLOCKS) {
            let mut products = [(0, [[0.0; 3]; 3]); MAX_BLOCKS];
            for (product, (first, block)) in products.iter_mut().zip(columns) {
                *product = (*first, (by_positions * block).data.0);
            }
            let columns = &products[..columns.len()];
            vectorised(Product { values: &mut *self.values, strip_len, first_strip, is_lower, rows, columns });
        }
    }
}

/// A product that is added to a panel.
struct Product<'a> {
    values: &'a mut [f64],
    strip_len: usize,
    /// Strip of the panel that is the first of the rows.
    first_strip: usize,
    /// Whether strips above the diagonal are left out.
    is_lower: bool,
    rows: &'a [Strip],
    /// First column, and three columns of derivatives.
    columns: &'a [(usize, [[f64; 3]; 3])],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.run::<S, 1>(simd),
            4 => self.run::<S, 2>(simd),
            2 => self.run::<S, 4>(simd),
            _ => self.run::<S, 8>(simd),
        }
    }
}

impl Product<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) {
        for (strip, rows) in self.rows {
            let [x, y, z] = rows.each_ref().map(|row| vectors::<S, V>(row)[0]);
            let at = (self.first_strip + strip) * self.strip_len;
            let values = &mut self.values[at..at + self.strip_len];
            for (first, block) in self.columns {
                if self.is_lower && STRIP * (strip + 1) <= *first {
                    continue;
                }
                let (targets, _) = S::as_mut_simd_f64s(&mut values[STRIP * first..STRIP * (first + 3)]);
                for (target, column) in targets.as_chunks_mut::<V>().0.iter_mut().zip(block) {
                    let factors = column.map(|factor| simd.splat_f64s(factor));
                    for (i, sum) in target.iter_mut().enumerate() {
                        *sum = simd.mul_add_e_f64s(x[i], factors[0], *sum);
                        *sum = simd.mul_add_e_f64s(y[i], factors[1], *sum);
                        *sum = simd.mul_add_e_f64s(z[i], factors[2], *sum);
                    }
                }
            }
        }
    }
}
