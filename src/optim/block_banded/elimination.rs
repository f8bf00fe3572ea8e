//! Elimination of the frames one after another, each in its own panel.
//!
//! Left-looking: a few columns at a time take what all columns before them ask of them, are divided by their small factor, and
//! are not touched again. Of earlier frames, only the last two reach a panel: the rows they have in common are the next frame's
//! rows of the one and those of the frame after the next of the other.

use super::kernel::{SmallFactor, Tile, add_product, divide, loaded, pack_negated, store};
use super::layout::{Layout, STRIP};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Columns that are eliminated together: with strips of two vectors, twelve sums and what feeds them fit sixteen registers.
const WIDTH: usize = 6;

/// Columns of a group, of which any number of unknowns is made.
const GROUP: usize = 3;

/// Columns of the corner that are computed together; they divide a strip.
const CORNER_WIDTH: usize = 4;

/// The elimination of successive frames; `None` where a diagonal block is not positive definite, or not finite.
pub(super) struct Elimination<'a> {
    pub layout: Layout,
    /// From the first frame on; afterwards those of the factor.
    pub panels: &'a mut [f64],
    /// By frame and strip, see [`super::layout::FramePanel`].
    pub starts: &'a [usize],
    /// To be eliminated; those before them are.
    pub frames: Range<usize>,
    /// Strips of the border by as many columns, to which the Schur complement's difference is added.
    pub corner: &'a mut [f64],
    /// The diagonal is multiplied by one plus this.
    pub damping: f64,
}

impl WithSimd for Elimination<'_> {
    type Output = Option<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<()> {
        match S::F64_LANES {
            8 => self.run::<S, 1>(simd),
            4 => self.run::<S, 2>(simd),
            2 => self.run::<S, 4>(simd),
            _ => self.run::<S, 8>(simd),
        }
    }
}

impl Elimination<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) -> Option<()> {
        let Self { layout, panels, starts, frames, corner, damping } = self;
        let (length, n_strips) = (layout.panel_len(), layout.frame_strips());
        let mut packed = Packed::new(layout);
        for t in frames {
            let (before, own) = panels.split_at_mut(t * length);
            let earlier = |lag: usize| {
                let t = t.checked_sub(lag)?;
                let starts = &starts[t * n_strips..(t + 1) * n_strips];
                Some(Eliminated { panel: &before[t * length..(t + 1) * length], starts })
            };
            let starts = &starts[t * n_strips..(t + 1) * n_strips];
            let mut frame = Frame { layout, own: &mut own[..length], starts, one: earlier(1), two: earlier(2) };
            frame.damp(damping);
            frame.eliminate::<S, V>(simd, &mut packed)?;
            frame.add_to_corner::<S, V>(simd, &mut packed.own, corner);
        }
        Some(())
    }
}

/// Rows of the columns at hand, as the kernel reads them.
struct Packed {
    own: Vec<f64>,
    one: Vec<f64>,
    two: Vec<f64>,
}

impl Packed {
    fn new(layout: Layout) -> Self {
        let rows = || vec![0.0; WIDTH * layout.n];
        Self { own: rows(), one: rows(), two: rows() }
    }
}

/// A frame before the one at hand.
struct Eliminated<'a> {
    panel: &'a [f64],
    starts: &'a [usize],
}

/// The frame at hand, and the two before it where there are any.
struct Frame<'a> {
    layout: Layout,
    own: &'a mut [f64],
    starts: &'a [usize],
    one: Option<Eliminated<'a>>,
    two: Option<Eliminated<'a>>,
}

impl Frame<'_> {
    fn damp(&mut self, damping: f64) {
        for i in 0..self.layout.n {
            self.own[self.layout.row(i) + STRIP * i] *= 1.0 + damping;
        }
    }

    #[inline(always)]
    fn eliminate<S: Simd, const V: usize>(&mut self, simd: S, packed: &mut Packed) -> Option<()> {
        let n = self.layout.n;
        let mut first = 0;
        while first + WIDTH <= n {
            self.eliminate_columns::<S, V, WIDTH>(simd, first, packed)?;
            first += WIDTH;
        }
        while first < n {
            self.eliminate_columns::<S, V, GROUP>(simd, first, packed)?;
            first += GROUP;
        }
        Some(())
    }

    #[inline(always)]
    fn eliminate_columns<S: Simd, const V: usize, const W: usize>(
        &mut self,
        simd: S,
        first: usize,
        packed: &mut Packed,
    ) -> Option<()> {
        let layout = self.layout;
        let start_of_two = self.pack::<W>(first, packed);
        let at = |strip: usize| strip * layout.strip_len() + STRIP * first;
        let on_diagonal = first / STRIP..(first + W - 1) / STRIP + 1;
        for strip in on_diagonal.clone() {
            let tile = self.updated::<S, V, W>(simd, strip, first, packed, start_of_two);
            store::<S, V, W>(&tile, &mut self.own[at(strip)..at(strip) + STRIP * W]);
        }
        let row = |i: usize| layout.row(first + i) + STRIP * first;
        let block: [[f64; W]; W] = std::array::from_fn(|i| std::array::from_fn(|j| self.own[row(i) + STRIP * j]));
        let factor = SmallFactor::of(&block)?;
        for strip in on_diagonal.start..layout.border_strips().end {
            let mut tile = if on_diagonal.contains(&strip) {
                loaded::<S, V, W>(simd, &self.own[at(strip)..at(strip) + STRIP * W])
            } else if self.start(strip) >= first + W {
                continue;
            } else {
                self.updated::<S, V, W>(simd, strip, first, packed, start_of_two)
            };
            divide(simd, &mut tile, &factor);
            store::<S, V, W>(&tile, &mut self.own[at(strip)..at(strip) + STRIP * W]);
        }
        Some(())
    }

    /// Packs the rows of the columns `first..first + W`; returns the first column in which those of two frames ago are not zero.
    #[inline(always)]
    fn pack<const W: usize>(&self, first: usize, packed: &mut Packed) -> usize {
        let layout = self.layout;
        let rows =
            |lag: usize| -> [usize; W] { std::array::from_fn(|i| layout.row(layout.frame_rows(lag) + first + i)) };
        pack_negated(rows(0).map(|row| &self.own[row..]), &mut packed.own[..W * first]);
        if let Some(one) = &self.one {
            pack_negated(rows(1).map(|row| &one.panel[row..]), &mut packed.one[..W * layout.n]);
        }
        let Some(two) = &self.two else { return layout.n };
        let start = two.starts[first / STRIP].min(two.starts[(first + W - 1) / STRIP]);
        let packed = &mut packed.two[W * start..W * layout.n];
        pack_negated(rows(2).map(|row| &two.panel[row + STRIP * start..]), packed);
        start
    }

    /// First column in which a strip of this frame's panel is not zero.
    #[inline(always)]
    fn start(&self, strip: usize) -> usize {
        let n = self.layout.frame_strips();
        if (2 * n..3 * n).contains(&strip) { self.starts[strip - 2 * n] } else { 0 }
    }

    /// A tile less what the columns before it, and those of earlier frames, ask of it.
    #[inline(always)]
    fn updated<S: Simd, const V: usize, const W: usize>(
        &self,
        simd: S,
        strip: usize,
        first: usize,
        packed: &Packed,
        start_of_two: usize,
    ) -> Tile<S, V, W> {
        let (n, length) = (self.layout.frame_strips(), self.layout.strip_len());
        let own = &self.own[strip * length..(strip + 1) * length];
        let mut tile = loaded::<S, V, W>(simd, &own[STRIP * first..STRIP * (first + W)]);
        let from = self.start(strip).min(first);
        add_product::<S, V, W>(simd, &mut tile, &own[STRIP * from..STRIP * first], &packed.own[W * from..]);
        let is_border = strip >= 3 * n;
        if let Some(one) = &self.one
            && (strip < 2 * n || is_border)
        {
            let from = if (n..2 * n).contains(&strip) { one.starts[strip - n] } else { 0 };
            let strip = if is_border { strip } else { strip + n };
            let rows = &one.panel[strip * length + STRIP * from..(strip + 1) * length];
            add_product::<S, V, W>(simd, &mut tile, rows, &packed.one[W * from..]);
        }
        if let Some(two) = &self.two
            && (strip < n || is_border)
        {
            let from = if is_border { start_of_two } else { start_of_two.max(two.starts[strip]) };
            let strip = if is_border { strip } else { strip + 2 * n };
            let rows = &two.panel[strip * length + STRIP * from..(strip + 1) * length];
            add_product::<S, V, W>(simd, &mut tile, rows, &packed.two[W * from..]);
        }
        tile
    }

    /// Subtracts the square of the border's rows, of which the lower triangle is computed.
    #[inline(always)]
    fn add_to_corner<S: Simd, const V: usize>(&self, simd: S, packed: &mut [f64], corner: &mut [f64]) {
        let layout = self.layout;
        if layout.n_border == 0 {
            return;
        }
        let strips = layout.border_strips();
        let packed = &mut packed[..CORNER_WIDTH * layout.n];
        for first in (0..STRIP * strips.len()).step_by(CORNER_WIDTH) {
            let row = |i: usize| &self.own[layout.row(layout.border_rows() + first + i)..];
            pack_negated::<CORNER_WIDTH>(std::array::from_fn(row), packed);
            for strip in first / STRIP..strips.len() {
                let at = STRIP * (strip * STRIP * strips.len() + first);
                let target = &mut corner[at..at + STRIP * CORNER_WIDTH];
                let own = (strips.start + strip) * layout.strip_len();
                let mut tile = loaded::<S, V, CORNER_WIDTH>(simd, target);
                add_product(simd, &mut tile, &self.own[own..own + layout.strip_len()], packed);
                store::<S, V, CORNER_WIDTH>(&tile, target);
            }
        }
    }
}
