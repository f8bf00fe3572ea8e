//! Gauss-Newton systems over time: one dense block per frame, coupled over two frames, and a narrow border.
//!
//! Exact and linear in the number of frames: a block Cholesky factor `H = L L^T` of bandwidth two blocks. The system is put
//! together in the memory in which it is factored, frame by frame ([`FramePanel`]), and the same memory takes the next one.

mod elimination;
mod frame_factor;
mod kernel;
mod layout;
mod pool;
mod products;
mod responses;
mod selected_inverse;
mod substitution;
#[cfg(test)]
mod tests;

use crate::optim::large_array::LargeArray;
use crate::optim::vectors::vectorised;
use elimination::Elimination;
pub use layout::FramePanel;
use layout::{Layout, STRIP};
use nalgebra::{DMatrix, DVector, Matrix3};
pub use pool::SystemPool;
pub use products::{ColumnBlock, Strip, StripRows, append_rows};
use rayon::prelude::*;
use std::ops::Range;
use substitution::Substitution;

/// Half of a symmetric system `H x = -gradient` over frames of `3 * n_groups` unknowns and a border.
#[derive(Debug, Clone, Default)]
pub struct BlockBanded {
    layout: Layout,
    /// A panel per frame.
    panels: LargeArray,
    /// By frame and strip of rows of the frame after the next, the first column that is not zero: smooth motions couple a
    /// joint's rotation with itself alone.
    starts: Vec<usize>,
    /// The border's own Hessian and gradient.
    pub corner: Corner,
    /// What eliminated frames add to the corner: strips of the border by as many columns.
    difference: Vec<f64>,
}

/// Frames that are filled together: with their panels, and the two before these, they fit into two megabytes of cache.
const RUN: usize = 4;

/// Number of sums beside the panels; each takes every so-manieth run. So many runs may be filled side by side.
pub const N_RESTS: usize = 4;

/// What fills a system, run by run.
pub trait Fill: Sync {
    /// What terms add to beside the panels.
    type Rest: Send;

    /// Makes `panels` what all terms within `frames` ask of these.
    fn within(&self, frames: Range<usize>, panels: &mut [FramePanel], rest: &mut Self::Rest);

    /// Adds the terms over frames before `first` that end there or a frame later. `panels`: those of the two frames before
    /// `first`, of `first`, and of the one after it where there is one.
    fn across(&self, first: usize, panels: &mut [FramePanel], rest: &mut Self::Rest);
}

/// Fills at most [`N_RESTS`] runs side by side. `open`: the panels of `frames` and of up to two frames before them.
fn fill_runs<F: Fill>(fill: &F, frames: Range<usize>, open: &mut [FramePanel], rests: &mut [F::Rest; N_RESTS]) {
    let rest_of = |first: usize| first / RUN % N_RESTS;
    let n_before = open.len() - frames.len();
    let runs = open[n_before..].par_chunks_mut(RUN).zip(rests[rest_of(frames.start)..].par_iter_mut());
    runs.enumerate().for_each(|(run, (panels, rest))| {
        let first = frames.start + RUN * run;
        fill.within(first..first + panels.len(), panels, rest);
    });
    for first in frames.clone().step_by(RUN).filter(|first| *first > 0) {
        let at = first - frames.start + n_before;
        let end = (at + 2).min(open.len());
        fill.across(first, &mut open[at - 2..end], &mut rests[rest_of(first)]);
    }
}

/// The system of the border's unknowns among themselves.
#[derive(Debug, Clone, Default)]
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
        let mut system = Self::default();
        system.reset(n_frames, n_groups, n_border);
        system
    }

    /// Makes it the zero system of this size. A system that served before keeps its memory.
    pub fn reset(&mut self, n_frames: usize, n_groups: usize, n_border: usize) {
        self.resize(n_frames, n_groups, n_border);
        self.frames().iter_mut().for_each(FramePanel::clear);
    }

    /// [`reset`](Self::reset), but for the frames: what they held stays until each is [cleared](FramePanel::clear). A panel that is
    /// cleared where it is filled does not leave the processor's cache in between.
    pub fn resize(&mut self, n_frames: usize, n_groups: usize, n_border: usize) {
        self.layout = Layout { n: 3 * n_groups, n_border };
        let n_panels = n_frames * self.layout.panel_len();
        if n_panels > self.panels.capacity() {
            // Nothing is copied. Room for a wider border costs nothing before it is used.
            self.panels = LargeArray::zeros(n_panels + n_panels / 4);
        }
        self.panels.set_len(n_panels);
        self.starts.resize(n_frames * self.layout.frame_strips(), 0);
        self.corner = Corner::zeros(n_border);
    }

    /// The frames, for terms that add to one each.
    pub fn frames(&mut self) -> Vec<FramePanel<'_>> {
        self.layout.frames(&mut self.panels, &mut self.starts)
    }

    /// One frame.
    pub fn frame(&mut self, t: usize) -> FramePanel<'_> {
        let layout = self.layout;
        let (panel, strips) = (layout.panel_len(), layout.frame_strips());
        FramePanel {
            layout,
            values: &mut self.panels[t * panel..(t + 1) * panel],
            starts: &mut self.starts[t * strips..(t + 1) * strips],
        }
    }

    /// Gradient of a frame.
    pub fn gradient(&self, t: usize) -> DVector<f64> {
        let layout = self.layout;
        let row = t * layout.panel_len() + layout.row(layout.border_rows() + layout.n_border);
        DVector::from_fn(layout.n, |column, _| self.panels[row + STRIP * column])
    }

    /// Adds a block at groups `row` of frame `later` and `column` of frame `earlier`, the same or at most two before it.
    pub fn add_block(&mut self, [later, earlier]: [usize; 2], [row, column]: [usize; 2], block: &Matrix3<f64>) {
        self.frame(earlier).add_block(later - earlier, [3 * row, 3 * column], block);
    }

    /// Solves with every diagonal entry multiplied by `1 + damping` (Marquardt 1963). The system is used up: before the next one
    /// it wants [`reset`](Self::reset).
    ///
    /// Returns `None` where the damped system is not positive definite, or not finite.
    pub fn solve(&mut self, damping: f64) -> Option<BandedStep> {
        self.eliminate(damping)?;
        self.solved(damping)
    }

    /// Eliminates the frames, with their diagonal multiplied by `1 + damping`; a system of the border remains.
    ///
    /// Systems that share unknowns of their borders are solved together by adding up the remaining systems.
    pub fn eliminated(mut self, damping: f64) -> Option<Eliminated> {
        self.eliminate(damping)?;
        Some(self.into_eliminated())
    }

    /// [`solve`](Self::solve) of a system whose frames were [eliminated](Self::fill_and_eliminate), and whose corner is complete.
    pub fn solved(&self, damping: f64) -> Option<BandedStep> {
        let (mut corner, right) = self.schur_complement();
        for k in 0..corner.nrows() {
            corner[(k, k)] += damping * self.corner.hessian[(k, k)];
        }
        let border = match corner.nrows() {
            0 => DVector::zeros(0),
            _ => corner.cholesky()?.solve(&right),
        };
        self.substituted(border, 1.0)
    }

    /// [`eliminated`](Self::eliminated) of a system whose frames were [eliminated](Self::fill_and_eliminate), and whose corner is
    /// complete.
    pub fn into_eliminated(self) -> Eliminated {
        let (corner, right) = self.schur_complement();
        Eliminated { factor: self, corner, right }
    }

    /// Fills a [resized](Self::resize) system and eliminates its frames, each soon after it is filled: a panel is larger than a
    /// processor's nearest cache, and many do not fit into any. With threads to spare some runs are filled side by side; every
    /// number of threads adds up in the same order.
    pub fn fill_and_eliminate<F: Fill>(
        &mut self,
        damping: f64,
        fill: &F,
        rests: &mut [F::Rest; N_RESTS],
    ) -> Option<()> {
        let layout = self.layout;
        let (length, n_strips) = (layout.panel_len(), layout.frame_strips());
        let n_frames = self.n_frames();
        let at_once = RUN * if rayon::current_num_threads() > 2 { N_RESTS } else { 1 };
        self.difference = layout.zero_difference();
        let (mut n_eliminated, difference) = (0, &mut self.difference);
        for first in (0..n_frames).step_by(at_once) {
            let (frames, n_full) = (first..(first + at_once).min(n_frames), first.saturating_sub(2));
            let (panels, open) = self.panels.split_at_mut(n_full * length);
            let (starts, open_starts) = self.starts.split_at_mut(n_full * n_strips);
            let n_open = frames.end - n_full;
            let mut open = layout.frames(&mut open[..n_open * length], &mut open_starts[..n_open * n_strips]);
            let elimination =
                Elimination { layout, panels, starts, frames: n_eliminated..n_full, corner: difference, damping };
            rayon::join(|| vectorised(elimination), || fill_runs(fill, frames, &mut open, rests)).0?;
            n_eliminated = n_full;
        }
        self.eliminate_frames(n_eliminated..n_frames, damping)
    }

    /// Replaces the panels by those of the factor.
    fn eliminate(&mut self, damping: f64) -> Option<()> {
        self.difference = self.layout.zero_difference();
        self.eliminate_frames(0..self.n_frames(), damping)
    }

    fn eliminate_frames(&mut self, frames: Range<usize>, damping: f64) -> Option<()> {
        let Self { layout, panels, starts, difference, .. } = self;
        vectorised(Elimination { layout: *layout, panels, starts, frames, corner: difference, damping })
    }

    fn n_frames(&self) -> usize {
        self.panels.len().checked_div(self.layout.panel_len()).unwrap_or(0)
    }

    /// The Hessian of the border, without damping, that remains after elimination.
    pub fn border_information(&self) -> DMatrix<f64> {
        self.schur_complement().0
    }

    /// The system of the border that remains after elimination: Schur complement of the undamped corner, right-hand side.
    fn schur_complement(&self) -> (DMatrix<f64>, DVector<f64>) {
        let n_rows = STRIP * self.layout.border_strips().len();
        let at = |row: usize, column: usize| self.difference[STRIP * ((row / STRIP) * n_rows + column) + row % STRIP];
        let Corner { hessian, gradient } = &self.corner;
        let n = self.layout.n_border;
        let corner = DMatrix::from_fn(n, n, |i, j| hessian[(i, j)] + at(i.max(j), i.min(j)));
        (corner, DVector::from_fn(n, |i, _| -(gradient[i] + at(n, i))))
    }

    /// The step of all frames of a factored system, given the border's and the share of the frames' gradient that counts.
    fn substituted(&self, border: DVector<f64>, gradient_share: f64) -> Option<BandedStep> {
        let Self { layout, panels, starts, .. } = self;
        let frames = vectorised(Substitution { layout: *layout, panels, starts, border: &border, gradient_share });
        let is_finite = border.iter().chain(frames.iter().flat_map(|f| f.iter())).all(|v| v.is_finite());
        is_finite.then_some(BandedStep { frames, border })
    }
}

/// A system after elimination of its frames: `corner * border = right` remains.
pub struct Eliminated {
    factor: BlockBanded,
    /// Schur complement of the undamped corner.
    pub corner: DMatrix<f64>,
    /// Its right-hand side.
    pub right: DVector<f64>,
}

impl Eliminated {
    /// The step of all frames, given the border's, with a share of what their own gradient asks for: with all of it they go to
    /// their minimum, with none those that are at it stay there as the border moves. `None` where it is not finite.
    pub fn step(&self, border: DVector<f64>, gradient_share: f64) -> Option<BandedStep> {
        self.factor.substituted(border, gradient_share)
    }

    /// The system that was used up, for the next one.
    pub fn into_system(self) -> BlockBanded {
        self.factor
    }
}

/// A matrix with every diagonal entry multiplied by `1 + damping` (Marquardt 1963).
pub fn damped(block: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut block = block.clone();
    for i in 0..block.nrows() {
        block[(i, i)] *= 1.0 + damping;
    }
    block
}
