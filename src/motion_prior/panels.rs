//! Products of small dense matrices in single precision, which take most of the network's time.
//!
//! Sums run over the inner index in ascending order with separate multiplications and additions, one accumulator an
//! entry: results are the same on every instruction set and with any number of threads. `pulp` chooses the widest vectors
//! of the processor; the build's baseline (SSE2) takes three times as long.

use rayon::prelude::*;

/// Columns of a panel: one AVX-512 register, or two AVX2 registers.
const LANES: usize = 16;
/// Rows processed in one pass over a panel: their sums fill the AVX2 registers.
const ROWS: usize = 6;
/// Smallest number of multiplications that is split among threads.
const PARALLEL_WORK: usize = 1 << 22;

/// A right factor `[n_in, n_out]`, its columns stored in panels of 16 so that one panel is read sequentially.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Panels {
    n_in: usize,
    n_out: usize,
    values: Vec<f32>,
}

impl Panels {
    /// Panels of a matrix `[n_in, n_out]`, given by rows.
    pub(crate) fn from_rows(matrix: &[f32], n_in: usize, n_out: usize) -> Self {
        let mut panels = Self::zeros(n_in, n_out);
        for (panel, block) in panels.values.chunks_exact_mut(n_in.max(1) * LANES).enumerate() {
            let (first, width) = (panel * LANES, LANES.min(n_out - panel * LANES));
            for (row, lanes) in block.chunks_exact_mut(LANES).enumerate() {
                lanes[..width].copy_from_slice(&matrix[row * n_out + first..][..width]);
            }
        }
        panels
    }

    /// Panels of the transpose of a matrix `[n_out, n_in]`, given by rows.
    pub(crate) fn from_columns(matrix: &[f32], n_in: usize, n_out: usize) -> Self {
        let mut panels = Self::zeros(n_in, n_out);
        for (panel, block) in panels.values.chunks_exact_mut(n_in.max(1) * LANES).enumerate() {
            for lane in 0..LANES.min(n_out - panel * LANES) {
                let column = &matrix[(panel * LANES + lane) * n_in..][..n_in];
                column.iter().enumerate().for_each(|(row, value)| block[row * LANES + lane] = *value);
            }
        }
        panels
    }

    fn zeros(n_in: usize, n_out: usize) -> Self {
        Self { n_in, n_out, values: vec![0.0; n_out.div_ceil(LANES) * n_in * LANES] }
    }
}

/// `y += x W`: `x` is `[n, n_in]`, `y` is `[n, n_out]`.
pub(crate) fn add_product(x: &[f32], w: &Panels, y: &mut [f32]) {
    if w.n_in == 0 || w.n_out == 0 {
        return;
    }
    let n = y.len() / w.n_out;
    debug_assert_eq!(x.len(), n * w.n_in);
    if n * w.n_in * w.n_out < PARALLEL_WORK {
        return add_rows(x, w, y);
    }
    let rows = n.div_ceil(16).next_multiple_of(ROWS);
    y.par_chunks_mut(rows * w.n_out).zip(x.par_chunks(rows * w.n_in)).for_each(|(y, x)| add_rows(x, w, y));
}

/// `x^T`: `x` is `[n, width]`.
pub(crate) fn transposed(x: &[f32], width: usize) -> Vec<f32> {
    let n = x.len() / width.max(1);
    let mut turned = vec![0.0; x.len()];
    for (row, values) in x.chunks_exact(width.max(1)).enumerate() {
        values.iter().enumerate().for_each(|(column, value)| turned[column * n + row] = *value);
    }
    turned
}

fn add_rows(x: &[f32], w: &Panels, y: &mut [f32]) {
    pulp::Arch::new().dispatch(AddRows { x, w, y });
}

/// [`add_rows`] as a task that is compiled for each instruction set.
struct AddRows<'a> {
    x: &'a [f32],
    w: &'a Panels,
    y: &'a mut [f32],
}

impl pulp::NullaryFnOnce for AddRows<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { x, w, y } = self;
        let mut packed = Vec::with_capacity(w.n_in * ROWS);
        for (x, y) in x.chunks(ROWS * w.n_in).zip(y.chunks_mut(ROWS * w.n_out)) {
            match x.len() / w.n_in {
                1 => add_block::<1>(x, w, y, &mut packed),
                2 => add_block::<2>(x, w, y, &mut packed),
                3 => add_block::<3>(x, w, y, &mut packed),
                4 => add_block::<4>(x, w, y, &mut packed),
                5 => add_block::<5>(x, w, y, &mut packed),
                _ => add_block::<ROWS>(x, w, y, &mut packed),
            }
        }
    }
}

#[inline(always)]
fn add_block<const R: usize>(x: &[f32], w: &Panels, y: &mut [f32], packed: &mut Vec<f32>) {
    // R rows interleaved, so that corresponding entries are contiguous.
    packed.resize(w.n_in * R, 0.0);
    for (r, row) in x.chunks_exact(w.n_in).enumerate() {
        packed.chunks_exact_mut(R).zip(row).for_each(|(slot, value)| slot[r] = *value);
    }
    for (panel, values) in w.values.chunks_exact(w.n_in * LANES).enumerate() {
        let mut sums = [[0.0_f32; LANES]; R];
        for (a, b) in packed.chunks_exact(R).zip(values.chunks_exact(LANES)) {
            for r in 0..R {
                for lane in 0..LANES {
                    sums[r][lane] += a[r] * b[lane];
                }
            }
        }
        let first = panel * LANES;
        let width = LANES.min(w.n_out - first);
        for (r, sums) in sums.iter().enumerate() {
            let row = &mut y[r * w.n_out + first..][..width];
            row.iter_mut().zip(sums).for_each(|(y, sum)| *y += sum);
        }
    }
}

/// `exp(x)` to 3e-7 relative for |x| < 80, in operations that vectorise and round the same on all machines: `2^k` from the
/// exponent's bits times the Taylor series of the rest, |g| <= ln 2 / 2.
#[inline(always)]
fn exp(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0; // 1.5 * 2^23: adding it removes the fraction
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    // ln 2 in two parts: the first has few bits, so that its product is exact.
    let g = (x - whole * 0.693_359_4) + whole * 2.121_944_4e-4;
    let series = 1.0 + g * (1.0 + g / 2.0 * (1.0 + g / 3.0 * (1.0 + g / 4.0 * (1.0 + g / 5.0 * (1.0 + g / 6.0)))));
    let power = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
    f32::from_bits(power) * series
}

/// `1 / (1 + e^-x)`.
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x.clamp(-40.0, 40.0)))
}

/// `tanh x`.
#[inline(always)]
pub(crate) fn tanh(x: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp((2.0 * x).clamp(-40.0, 40.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, step: f32) -> Vec<f32> {
        (0..n).map(|i| (i as f32 * step).sin()).collect()
    }

    /// Every remainder of rows and of lanes; sums of 37 products of numbers below 1 round by less than 1e-5.
    #[test]
    fn products_agree_with_the_definition() {
        for (n, n_in, n_out) in [(1, 3, 1), (5, 37, 16), (6, 37, 17), (13, 37, 50), (40, 1, 33)] {
            let (x, w) = (wave(n * n_in, 0.7), wave(n_in * n_out, 1.3));
            let mut y = vec![1.0; n * n_out];
            add_product(&x, &Panels::from_rows(&w, n_in, n_out), &mut y);
            let turned = Panels::from_columns(&transposed(&w, n_out), n_in, n_out);
            assert_eq!(turned, Panels::from_rows(&w, n_in, n_out));
            for (row, column) in (0..n).flat_map(|r| (0..n_out).map(move |c| (r, c))) {
                let sum: f32 = (0..n_in).map(|k| x[row * n_in + k] * w[k * n_out + column]).sum();
                assert!((y[row * n_out + column] - 1.0 - sum).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let (x, w) = (wave(300 * 200, 0.37), wave(200 * 90, 0.91));
        let w = Panels::from_rows(&w, 200, 90);
        let product = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut y = vec![0.0; 300 * 90];
            pool.install(|| add_product(&x, &w, &mut y));
            y
        };
        assert_eq!(product(1), product(3));
    }

    #[test]
    fn the_activations_agree_with_the_standard_library() {
        for i in -2000..2000 {
            let x = i as f32 * 0.02;
            assert!((tanh(x) - x.tanh()).abs() < 1e-6, "{x}");
            assert!((sigmoid(x) - 1.0 / (1.0 + (-x).exp())).abs() < 1e-6, "{x}");
        }
    }
}
