//! Windows of long takes on a fixed grid: time and memory are linear in length, and a frame's result does not depend on the
//! length of the take.
//!
//! Windows of 128 frames start every 96; neighbours share 32 frames and are blended over the middle 16 of them, so that
//! every result has at least 8 frames of context on each side. Windows of equal length, of any takes, run as one batch.

use super::vae::{interleaved, separated};

/// Length of a window, frames: the longest clip of the training.
pub const WINDOW_FRAMES: usize = 128;
/// Frames from the start of one window to that of the next.
pub const WINDOW_STRIDE: usize = 96;
/// Frames at each end of the overlap where only one window has weight.
const HALO: usize = 8;
const OVERLAP: usize = WINDOW_FRAMES - WINDOW_STRIDE;

/// Most windows in a batch: more do not fit the caches; bounds the memory.
const BATCH: usize = 16;

/// A window of one take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    /// Index of the take.
    take: usize,
    start: usize,
    len: usize,
    /// Whether it is the take's last window.
    is_last: bool,
}

impl Window {
    /// Weight of the window's result at its frame `i`; the weights of all windows of a frame sum to 1.
    fn weight(&self, i: usize) -> f32 {
        let rise = |i: usize| ((i as f32 - HALO as f32 + 0.5) / (OVERLAP - 2 * HALO) as f32).clamp(0.0, 1.0);
        let from = if self.start == 0 { 1.0 } else { rise(i) };
        let to = if self.is_last || i < WINDOW_STRIDE { 1.0 } else { 1.0 - rise(i - WINDOW_STRIDE) };
        from * to
    }
}

/// Windows of equal length that run together.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WindowBatch(Vec<Window>);

/// All windows of takes of the given lengths.
pub(crate) fn window_batches(lengths: &[usize]) -> Vec<WindowBatch> {
    let mut windows = Vec::new();
    for (take, n_frames) in lengths.iter().enumerate().filter(|(_, n)| **n > 0) {
        let n_windows = 1 + n_frames.saturating_sub(WINDOW_FRAMES).div_ceil(WINDOW_STRIDE);
        windows.extend((0..n_windows).map(|k| {
            let start = k * WINDOW_STRIDE;
            Window { take, start, len: WINDOW_FRAMES.min(n_frames - start), is_last: k + 1 == n_windows }
        }));
    }
    windows.sort_by_key(|window| window.len);
    let of_one_length = windows.chunk_by(|a, b| a.len == b.len);
    of_one_length.flat_map(|group| group.chunks(BATCH)).map(|batch| WindowBatch(batch.to_vec())).collect()
}

impl WindowBatch {
    /// Number of windows, B.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// The windows' parts of takes `[T, width]` as `[T, B, width]`.
    pub(crate) fn cut(&self, takes: &[&[f32]], width: usize) -> Vec<f32> {
        let part = |w: &Window| &takes[w.take][w.start * width..(w.start + w.len) * width];
        interleaved(&self.0.iter().map(part).collect::<Vec<_>>(), width)
    }

    /// Adds results `[T, B, width]`, weighted, to takes `[T, width]`.
    pub(crate) fn blend(&self, results: &[f32], width: usize, takes: &mut [Vec<f32>]) {
        for (window, result) in self.0.iter().zip(separated(results, width, self.len())) {
            let rows = takes[window.take][window.start * width..].chunks_exact_mut(width);
            for (i, (row, result)) in rows.zip(result.chunks_exact(width)).enumerate() {
                let weight = window.weight(i);
                row.iter_mut().zip(result).for_each(|(sum, x)| *sum += weight * x);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blending_inverts_cutting() {
        let lengths = [1, 8, 128, 129, 161, 300, 2000];
        let takes: Vec<Vec<f32>> = lengths.iter().map(|n| (0..n * 2).map(|i| (i as f32).sin()).collect()).collect();
        let views: Vec<&[f32]> = takes.iter().map(Vec::as_slice).collect();
        let mut blended: Vec<Vec<f32>> = lengths.iter().map(|n| vec![0.0; n * 2]).collect();
        for batch in window_batches(&lengths) {
            batch.blend(&batch.cut(&views, 2), 2, &mut blended);
        }
        for (found, given) in blended.iter().flatten().zip(takes.iter().flatten()) {
            assert!((found - given).abs() < 1e-6);
        }
    }
}
