//! Where the numbers of a frame lie: its panel, the block column of the lower triangle of the system.
//!
//! The rows of a panel are those of the frame itself, of the next frame, of the one after it, of the border, and the gradient;
//! its columns are the frame's unknowns. Eight rows form a strip, column after column, so that the kernels read nothing but
//! successive numbers. Each of the four parts begins with a strip of its own; what it leaves of its last one stays zero.

use nalgebra::{Matrix3, SMatrix};
use std::ops::Range;

/// Rows of a strip: a whole number of vectors on every processor (two of AVX2).
pub(super) const STRIP: usize = 8;

/// The extent of all panels of a system.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Layout {
    /// Unknowns of a frame.
    pub n: usize,
    pub n_border: usize,
}

impl Layout {
    /// Strips of the rows of one frame.
    pub(super) fn frame_strips(self) -> usize {
        self.n.div_ceil(STRIP)
    }

    /// Strips of the border's rows and the gradient.
    pub(super) fn border_strips(self) -> Range<usize> {
        let first = 3 * self.frame_strips();
        first..first + (self.n_border + 1).div_ceil(STRIP)
    }

    /// Numbers of a strip.
    pub(super) fn strip_len(self) -> usize {
        STRIP * self.n
    }

    /// Numbers of a panel.
    pub(super) fn panel_len(self) -> usize {
        self.strip_len() * self.border_strips().end
    }

    /// Panels of successive frames, one after another.
    pub(super) fn frames<'a>(self, panels: &'a mut [f64], starts: &'a mut [usize]) -> Vec<FramePanel<'a>> {
        let panels = panels.chunks_exact_mut(self.panel_len());
        let starts = starts.chunks_exact_mut(self.frame_strips());
        panels.zip(starts).map(|(values, starts)| FramePanel { layout: self, values, starts }).collect()
    }

    /// Zeros for strips of the border by as many columns.
    pub(super) fn zero_difference(self) -> Vec<f64> {
        vec![0.0; (STRIP * self.border_strips().len()).pow(2)]
    }

    /// Place of a row in a panel: that of its first column.
    pub(super) fn row(self, row: usize) -> usize {
        (row / STRIP) * self.strip_len() + row % STRIP
    }

    /// First row of the unknowns `lag` frames later.
    pub(super) fn frame_rows(self, lag: usize) -> usize {
        lag * self.frame_strips() * STRIP
    }

    /// First row of the border; that of the gradient follows its last.
    pub(super) fn border_rows(self) -> usize {
        self.frame_rows(3)
    }
}

/// One frame of a system while it is put together.
pub struct FramePanel<'a> {
    pub(super) layout: Layout,
    pub(super) values: &'a mut [f64],
    /// By strip of the frame after the next, the first column that is not zero.
    pub(super) starts: &'a mut [usize],
}

impl FramePanel<'_> {
    /// Makes it zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.starts.fill(self.layout.n);
    }

    /// Adds to `H[t][t]` at two groups; only the lower triangle is read.
    pub fn add_own<const R: usize, const C: usize>(&mut self, row: usize, column: usize, block: &SMatrix<f64, R, C>) {
        self.add(row, column, block);
    }

    /// Adds to `H[t + lag][t]` at a row of the later frame and a column of this one; `lag`: one or two.
    pub fn add_coupling<const R: usize, const C: usize>(
        &mut self,
        lag: usize,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        if lag == 2 {
            for start in &mut self.starts[row / STRIP..=(row + R - 1) / STRIP] {
                *start = column.min(*start);
            }
        }
        self.add(self.layout.frame_rows(lag) + row, column, block);
    }

    /// Adds to `H[t + lag][t]` at a row of the later frame and a column of this one; `lag`: at most two.
    pub fn add_block(&mut self, lag: usize, [row, column]: [usize; 2], block: &Matrix3<f64>) {
        match lag {
            0 => self.add_own(row, column, block),
            lag => self.add_coupling(lag, row, column, block),
        }
    }

    /// Adds to `H[border][t]` at a row of the border.
    pub fn add_border<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        self.add(self.layout.border_rows() + row, column, block);
    }

    /// Adds to the gradient.
    pub fn add_gradient<const R: usize>(&mut self, first: usize, part: &SMatrix<f64, R, 1>) {
        let row = self.layout.row(self.layout.border_rows() + self.layout.n_border);
        for (i, value) in part.iter().enumerate() {
            self.values[row + STRIP * (first + i)] += value;
        }
    }

    /// Adds a number to the diagonal.
    pub fn add_to_diagonal(&mut self, value: f64) {
        for i in 0..self.layout.n {
            self.values[self.layout.row(i) + STRIP * i] += value;
        }
    }

    /// Multiplies what was added to the frame itself, to its rows of the border, and to its gradient.
    pub fn scale_own(&mut self, factor: f64) {
        let (own, border) = (self.layout.row(self.layout.frame_rows(1)), self.layout.row(self.layout.border_rows()));
        for values in [0..own, border..self.values.len()] {
            self.values[values].iter_mut().for_each(|value| *value *= factor);
        }
    }

    fn add<const R: usize, const C: usize>(&mut self, row: usize, column: usize, block: &SMatrix<f64, R, C>) {
        for i in 0..R {
            let at = self.layout.row(row + i) + STRIP * column;
            for k in 0..C {
                self.values[at + STRIP * k] += block[(i, k)];
            }
        }
    }
}
