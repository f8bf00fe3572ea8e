//! Errors of a detector over time: an autoregressive process of order two, and the factors that whiten it.
//!
//! Detectors' errors are slow: on real detections their autocorrelation is 0.8 from frame to frame and 0.4 after a second.
//! A residual in itself then says little that its predecessor did not say; what is new is the innovation
//!
//! `e_t = (r_t - a_1 r_{t-1} - a_2 r_{t-2}) / s`
//!
//! with `a` and `s` from the autocorrelations of lags one and two (Yule 1927, Walker 1931). Innovations are uncorrelated, so that
//! a sum of their squares is the log likelihood of a path.

use nalgebra::Vector2;

/// The process of standardised residuals: unit variance where nothing came before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NoiseProcess {
    /// Autocorrelation after one and two frames.
    pub autocorrelation: [f64; 2],
}

/// Longest gap whose memory is computed, frames.
const MAX_GAP: usize = 10_000;

/// Bounds of an autocorrelation: beyond the upper one level and innovation could not be separated numerically.
const BOUNDS: [f64; 2] = [0.0, 0.995];

/// Residuals beyond this many standard deviations are not part of the process.
const OUTLIER: f64 = 4.0;

impl NoiseProcess {
    /// From sums of products.
    pub(crate) fn of(sums: &LagSums) -> Self {
        let autocorrelation = |[product, square]: [f64; 2]| {
            if square > 0.0 { (product / square).clamp(BOUNDS[0], BOUNDS[1]) } else { 0.0 }
        };
        let [one, two] = sums.lags.map(autocorrelation);
        // A stationary process needs rho_2 > 2 rho_1^2 - 1; one that oscillates would not be a detector's.
        Self { autocorrelation: [one, two.clamp(one * one, one.max(one * one))] }
    }

    /// Factors of the residuals of a frame, the one before and the one before that, given how long ago this keypoint was last
    /// seen: `[seen one frame ago, seen two frames ago]`, and the frames since it was last seen at all.
    pub(crate) fn innovation(&self, [one_ago, two_ago]: [bool; 2], gap: Option<usize>) -> [f64; 3] {
        let [first, second] = self.autocorrelation;
        match (one_ago, two_ago) {
            (true, true) => {
                let determinant = 1.0 - first * first;
                let a = [first * (1.0 - second) / determinant, (second - first * first) / determinant];
                let sigma = (1.0 - a[0] * first - a[1] * second).max(1e-4).sqrt();
                [1.0 / sigma, -a[0] / sigma, -a[1] / sigma]
            }
            (true, false) => {
                let sigma = (1.0 - first * first).sqrt();
                [1.0 / sigma, -first / sigma, 0.0]
            }
            (false, true) => {
                let sigma = (1.0 - second * second).sqrt();
                [1.0 / sigma, 0.0, -second / sigma]
            }
            // What was known before the gap is not counted again.
            (false, false) => {
                let memory = gap.map_or(0.0, |gap| self.memory(gap));
                [(1.0 - memory * memory).sqrt(), 0.0, 0.0]
            }
        }
    }

    /// Autocorrelation after `gap` frames, at least three.
    fn memory(&self, gap: usize) -> f64 {
        let [first, second] = self.autocorrelation;
        if first <= 0.0 {
            return 0.0;
        }
        second * (second / first).powi(gap.min(MAX_GAP) as i32 - 2)
    }
}

/// Sums over pairs of residuals one and two frames apart: of their products, and of their mean squares.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LagSums {
    lags: [[f64; 2]; 2],
}

impl LagSums {
    /// Adds a channel: a run of (frame, standardised residual) of one keypoint in one camera, ascending.
    pub(crate) fn add(&mut self, channel: &[(usize, Vector2<f64>)]) {
        for (lag, sums) in (1..).zip(&mut self.lags) {
            for (i, (frame, now)) in channel.iter().enumerate() {
                let before = channel[..i].iter().rev().take(lag).find(|(earlier, _)| earlier + lag == *frame);
                let Some((_, before)) = before else { continue };
                if now.norm() < OUTLIER && before.norm() < OUTLIER {
                    sums[0] += now.dot(before);
                    sums[1] += 0.5 * (now.norm_squared() + before.norm_squared());
                }
            }
        }
    }

    /// These and a share of others, `weight` mean squares of them.
    pub(crate) fn pooled(&self, others: &Self, weight: f64) -> Self {
        let mut pooled = *self;
        for (own, other) in pooled.lags.iter_mut().zip(&others.lags) {
            let factor = weight / other[1].max(f64::MIN_POSITIVE);
            own[0] += factor * other[0];
            own[1] += factor * other[1];
        }
        pooled
    }
}

/// The detector's errors by landmark.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PathNoise {
    pub processes: Vec<NoiseProcess>,
    /// Standard deviation per axis as a share of the pixels' scale.
    pub shares: Vec<f64>,
}

impl PathNoise {
    /// The same independent noise for all landmarks.
    pub(crate) fn white(n_landmarks: usize, share: f64) -> Self {
        Self {
            processes: vec![NoiseProcess { autocorrelation: [0.0; 2] }; n_landmarks],
            shares: vec![share; n_landmarks],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const PROCESS: NoiseProcess = NoiseProcess { autocorrelation: [0.84, 0.75] };

    /// A path of the process: its innovations are drawn, and the factors inverted.
    fn path(n: usize) -> Vec<(usize, Vector2<f64>)> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut path: Vec<(usize, Vector2<f64>)> = Vec::with_capacity(n);
        for t in 0..n {
            let [own, one, two] = PROCESS.innovation([t >= 1, t >= 2], None);
            let at = |lag: usize| t.checked_sub(lag).map_or_else(Vector2::zeros, |i| path[i].1);
            let drawn = Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng));
            path.push((t, (drawn - at(1) * one - at(2) * two) / own));
        }
        path
    }

    /// 20,000 frames of correlation time 10 know an autocorrelation to 0.01; clipping at four sigma costs less.
    #[test]
    fn autocorrelation_of_a_path_is_measured() {
        let mut sums = LagSums::default();
        sums.add(&path(20_000));
        let found = NoiseProcess::of(&sums).autocorrelation;
        for (found, truth) in found.into_iter().zip(PROCESS.autocorrelation) {
            assert!((found - truth).abs() < 0.02, "{found} for {truth}");
        }
        assert_eq!(NoiseProcess::of(&LagSums::default()).autocorrelation, [0.0; 2]);
    }

    /// The level's variance is one: what the process draws has the variance that a first residual is given.
    #[test]
    fn a_path_of_unit_innovations_has_unit_variance() {
        let path = path(20_000);
        let variance = path.iter().map(|(_, r)| 0.5 * r.norm_squared()).sum::<f64>() / path.len() as f64;
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
    }

    #[test]
    fn after_a_gap_only_what_was_forgotten_counts() {
        let weight = |gap: Option<usize>| PROCESS.innovation([false; 2], gap)[0];
        assert_eq!(weight(None), 1.0);
        assert!(weight(Some(3)) < weight(Some(10)) && weight(Some(10)) < weight(Some(1000)));
        assert!((weight(Some(1000)) - 1.0).abs() < 1e-9);
        let white = NoiseProcess { autocorrelation: [0.0; 2] };
        assert_eq!(white.innovation([true, true], Some(1)), [1.0, 0.0, 0.0]);
        assert_eq!(white.innovation([false, false], Some(5)), [1.0, 0.0, 0.0]);
    }

    /// Few residuals of a landmark are drawn towards those of all.
    #[test]
    fn sparse_landmarks_take_the_process_of_all() {
        let mut all = LagSums::default();
        all.add(&path(5_000));
        let pooled = NoiseProcess::of(&LagSums::default().pooled(&all, 100.0));
        assert!((pooled.autocorrelation[0] - NoiseProcess::of(&all).autocorrelation[0]).abs() < 1e-12);
    }
}
