//! The most certain step of a quantity that is known block by block.

use nalgebra::SVector;

/// Smallest number of blocks on each side of a step.
const MIN_BLOCKS: usize = 4;
/// Largest correlation between neighbouring blocks that is allowed for.
const MAX_CORRELATION: f64 = 0.8;

/// A step of a camera's rotation or clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// First frame after it.
    pub frame: usize,
    /// Its size.
    pub size: f64,
    /// Size over its standard error, all components together.
    pub sigmas: f64,
    /// Whether a line through all blocks leaves less than the step.
    pub is_gradual: bool,
    /// Slope of that line over its standard error.
    pub slope_sigmas: f64,
}

/// The most certain step of a series of blocks of `block` frames; `None` with too few of them.
pub(super) fn most_certain_step<const N: usize>(series: &[Option<SVector<f64, N>>], block: usize) -> Option<Step> {
    let known: Blocks<N> = series.iter().enumerate().filter_map(|(b, value)| value.map(|value| (b, value))).collect();
    let line = Line::through(&known);
    let splits = MIN_BLOCKS..(known.len() + 1).saturating_sub(MIN_BLOCKS);
    let steps = splits.filter_map(|at| {
        let (before, after) = known.split_at(at);
        let (sigmas, size) = difference(before, after)?;
        let is_gradual = line.left < left_by_mean(before) + left_by_mean(after);
        Some(Step { frame: after[0].0 * block, size, sigmas, is_gradual, slope_sigmas: line.sigmas })
    });
    steps.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas))
}

/// Numbers and values of the known blocks.
type Blocks<const N: usize> = Vec<(usize, SVector<f64, N>)>;

fn mean<const N: usize>(blocks: &[(usize, SVector<f64, N>)]) -> SVector<f64, N> {
    blocks.iter().map(|(_, value)| value).sum::<SVector<f64, N>>() / blocks.len() as f64
}

/// Sum of squares about the mean.
fn left_by_mean<const N: usize>(blocks: &[(usize, SVector<f64, N>)]) -> f64 {
    let mean = mean(blocks);
    blocks.iter().map(|(_, value)| (value - mean).norm_squared()).sum()
}

/// The line through all blocks by least squares.
struct Line {
    /// Sum of squares about it.
    left: f64,
    /// Its slope over its standard error, all components together, with the correlation of neighbouring blocks.
    sigmas: f64,
}

impl Line {
    fn through<const N: usize>(blocks: &[(usize, SVector<f64, N>)]) -> Self {
        let centre = blocks.iter().map(|(b, _)| *b as f64).sum::<f64>() / blocks.len() as f64;
        let (mut spread, mut along) = (0.0, SVector::<f64, N>::zeros());
        for (b, value) in blocks {
            spread += (*b as f64 - centre).powi(2);
            along += value * (*b as f64 - centre);
        }
        let (mean, slope) = (mean(blocks), along / spread);
        let rests: Blocks<N> =
            blocks.iter().map(|(b, value)| (*b, value - mean - slope * (*b as f64 - centre))).collect();
        let left: f64 = rests.iter().map(|(_, rest)| rest.norm_squared()).sum();
        let lagged: f64 = rests.windows(2).map(|pair| pair[0].1.dot(&pair[1].1)).sum();
        let correlation = (lagged / left.max(f64::MIN_POSITIVE)).clamp(0.0, MAX_CORRELATION);
        let variance = left / (N as f64 * (blocks.len() as f64 - 2.0)) / spread;
        let error = variance * (1.0 + correlation) / (1.0 - correlation);
        Self { left, sigmas: slope.norm() / error.max(f64::MIN_POSITIVE).sqrt() }
    }
}

/// Difference of two means over its standard error, and its size; the variance is that within the two, with the correlation of
/// neighbouring blocks.
fn difference<const N: usize>(
    before: &[(usize, SVector<f64, N>)],
    after: &[(usize, SVector<f64, N>)],
) -> Option<(f64, f64)> {
    let means = [mean(before), mean(after)];
    let rests: Vec<Vec<SVector<f64, N>>> = [before, after]
        .iter()
        .zip(&means)
        .map(|(part, mean)| part.iter().map(|(_, value)| value - mean).collect())
        .collect();
    let (mut variance, mut lagged, mut n_lagged) = (SVector::<f64, N>::zeros(), SVector::<f64, N>::zeros(), 0.0);
    for rests in &rests {
        rests.iter().for_each(|rest| variance += rest.component_mul(rest));
        rests.windows(2).for_each(|pair| lagged += pair[0].component_mul(&pair[1]));
        n_lagged += rests.len() as f64 - 1.0;
    }
    let n = (before.len() + after.len()) as f64;
    let variance = variance / (n - 2.0);
    let (step, share) = (means[1] - means[0], 1.0 / before.len() as f64 + 1.0 / after.len() as f64);
    let mut squared = 0.0;
    for axis in 0..N {
        // A mean of n correlated values: n (1 - r) / (1 + r) count.
        let correlation = (lagged[axis] / n_lagged / variance[axis].max(f64::MIN_POSITIVE)).clamp(0.0, MAX_CORRELATION);
        let error = variance[axis] * share * (1.0 + correlation) / (1.0 - correlation);
        squared += step[axis] * step[axis] / error.max(f64::MIN_POSITIVE);
    }
    squared.is_finite().then(|| (squared.sqrt(), step.norm()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_differs_from_a_step() {
        let wobble = |b: usize| 0.1 * (3.0 * b as f64).sin();
        let step = |value: &dyn Fn(usize) -> f64| {
            let blocks: Vec<_> = (0..40).map(|b| (b % 7 > 0).then(|| SVector::from([value(b) + wobble(b)]))).collect();
            most_certain_step(&blocks, 15).unwrap()
        };
        let stepped = step(&|b| if b < 24 { 0.0 } else { 2.0 });
        assert!(!stepped.is_gradual && stepped.frame == 24 * 15 && (stepped.size - 2.0).abs() < 0.1, "{stepped:?}");
        let drifting = step(&|b| 0.05 * b as f64);
        assert!(drifting.slope_sigmas > 20.0 && step(&|_| 0.0).slope_sigmas < 2.0, "{drifting:?}");
        assert!(drifting.is_gradual && (drifting.size - 1.0).abs() < 0.2, "{drifting:?}");
    }
}
