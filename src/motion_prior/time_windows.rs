//! Motions of any length and frame rate as batches of windows on the 30 Hz grid, and back.
//!
//! Windows lie on a fixed grid of the take and fade into each other where they overlap, so that the recurrent part of a network
//! takes the same number of steps for a take of any length. All maps are linear, and candle differentiates through them.

use super::dataset::GRID_FPS;
use candle_core::{Device, Result, Tensor};

/// Frames of a window, and from one window to the next; the states of a GRU need some ten frames to settle.
const WINDOW: usize = 160;
const STEP: usize = 128;

/// Rows that lie between two rows each.
struct Mixture {
    first: Tensor,
    second: Tensor,
    /// Of the second row, `[N, 1]`.
    share: Tensor,
}

impl Mixture {
    fn new(rows: &[(usize, usize, f64)]) -> Result<Self> {
        let rows_of = |row: fn(&(usize, usize, f64)) -> usize| {
            Tensor::from_iter(rows.iter().map(|r| row(r) as u32), &Device::Cpu)
        };
        let share = Tensor::from_iter(rows.iter().map(|row| row.2 as f32), &Device::Cpu)?.reshape((rows.len(), 1))?;
        Ok(Self { first: rows_of(|row| row.0)?, second: rows_of(|row| row.1)?, share })
    }

    /// `[M, C]` to `[N, C]`.
    fn of(&self, x: &Tensor) -> Result<Tensor> {
        let first = x.index_select(&self.first, 0)?;
        let way = (x.index_select(&self.second, 0)? - &first)?;
        first + way.broadcast_mul(&self.share)?
    }
}

/// The windows of a take.
pub(super) struct TimeWindows {
    shape: [usize; 2],
    from_frames: Mixture,
    to_grid: Mixture,
    to_frames: Mixture,
}

impl TimeWindows {
    /// Of a take of `n_frames`, at least one, at `fps`.
    pub(super) fn new(n_frames: usize, fps: f64) -> Result<Self> {
        let n_grid = ((n_frames - 1) as f64 * GRID_FPS / fps - 1e-6).ceil() as usize + 1;
        let n_windows = n_grid.saturating_sub(WINDOW - STEP).div_ceil(STEP).max(1);
        let length = n_grid.min(WINDOW);
        let between = |at: f64, n: usize| {
            let at = at.min((n - 1) as f64);
            (at.floor() as usize, at.ceil() as usize, at.fract())
        };
        let window_row = |window: usize, place: usize| place * n_windows + window;
        let frames_of_row = |row: usize| {
            let grid = (row % n_windows * STEP + row / n_windows).min(n_grid - 1);
            between(grid as f64 * fps / GRID_FPS, n_frames)
        };
        let rows_of_grid = |grid: usize| {
            let window = (grid / STEP).min(n_windows - 1);
            let place = grid - window * STEP;
            let own = window_row(window, place);
            if window == 0 || place + STEP >= WINDOW {
                return (own, own, 0.0);
            }
            (window_row(window - 1, place + STEP), own, (place as f64 + 0.5) / (WINDOW - STEP) as f64)
        };
        let frames = |frame: usize| between(frame as f64 * GRID_FPS / fps, n_grid);
        Ok(Self {
            shape: [length, n_windows],
            from_frames: Mixture::new(&(0..length * n_windows).map(frames_of_row).collect::<Vec<_>>())?,
            to_grid: Mixture::new(&(0..n_grid).map(rows_of_grid).collect::<Vec<_>>())?,
            to_frames: Mixture::new(&(0..n_frames).map(frames).collect::<Vec<_>>())?,
        })
    }

    /// `[T, C]` to `[L, W, C]`: the frames of each window.
    pub(super) fn split(&self, x: &Tensor) -> Result<Tensor> {
        self.from_frames.of(x)?.reshape((self.shape[0], self.shape[1], x.dim(1)?))
    }

    /// `[L, W, C]` to `[T, C]`.
    pub(super) fn joined(&self, x: &Tensor) -> Result<Tensor> {
        self.to_frames.of(&self.to_grid.of(&x.flatten(0, 1)?)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight line in time survives windows and frame rates.
    #[test]
    fn windows_join_to_the_take_they_were_cut_from() {
        for (n_frames, fps) in [(1, 30.0), (2, 25.0), (160, 30.0), (161, 30.0), (417, 30.0), (500, 25.0), (731, 60.0)] {
            let take: Vec<f32> = (0..2 * n_frames).map(|i| (i / 2) as f32).collect();
            let take = Tensor::from_vec(take, (n_frames, 2), &Device::Cpu).unwrap();
            let windows = TimeWindows::new(n_frames, fps).unwrap();
            let split = windows.split(&take).unwrap();
            assert!(split.dim(0).unwrap() <= WINDOW);
            let joined = windows.joined(&split).unwrap();
            assert_eq!(joined.dims(), take.dims());
            let off = (joined - take).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap();
            // At other rates the last grid sample repeats the last frame.
            assert!(off < if fps == 30.0 { 1e-4 } else { 0.5 }, "{n_frames} {fps}: {off}");
        }
    }
}
