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
}

/// The most certain step of a series of blocks of `block` frames; `None` with too few of them.
pub(super) fn most_certain_step<const N: usize>(series: &[Option<SVector<f64, N>>], block: usize) -> Option<Step> {
    let known: Vec<(usize, SVector<f64, N>)> =
        series.iter().enumerate().filter_map(|(b, value)| value.map(|value| (b, value))).collect();
    let splits = MIN_BLOCKS..(known.len() + 1).saturating_sub(MIN_BLOCKS);
    let steps = splits.filter_map(|at| {
        let (before, after) = known.split_at(at);
        let (sigmas, size) = difference(before, after)?;
        Some(Step { frame: after[0].0 * block, size, sigmas })
    });
    steps.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas))
}

/// Difference of two means over its standard error, and its size; the variance is that within the two, with the correlation of
/// neighbouring blocks.
fn difference<const N: usize>(
    before: &[(usize, SVector<f64, N>)],
    after: &[(usize, SVector<f64, N>)],
) -> Option<(f64, f64)> {
    let mean = |part: &[(usize, SVector<f64, N>)]| {
        part.iter().map(|(_, value)| value).sum::<SVector<f64, N>>() / part.len() as f64
    };
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
