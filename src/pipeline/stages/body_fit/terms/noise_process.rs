//! Errors of a detector over time: an autoregressive process of order two, and the factors that whiten it.
//!
//! Detectors' errors are slow: on real detections their autocorrelation is 0.8 from frame to frame and 0.4 after a second.
//! A residual in itself then says little that its predecessors did not say; what is new is the innovation
//!
//! `e_t = (r_t - a_1 r_{t-1} - a_2 r_{t-2}) / s`
//!
//! of the process with the measured autocorrelation after one frame and the measured decay over longer times. Innovations are
//! uncorrelated, so that a sum of their squares is the log likelihood of a path.
//!
//! The coefficients that predict best from two frames (Yule 1927, Walker 1931) forget within some frames what errors keep for
//! seconds. With the measured decay a level counts for less: cameras come 5 %, joints 1.5 % closer on realistic noise.

use crate::optim::robust::median;
use nalgebra::Vector2;

/// The process of standardised residuals: unit variance where nothing came before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NoiseProcess {
    /// Autocorrelation after one frame, `rho`.
    pub autocorrelation: f64,
    /// Factor of the autocorrelation from a frame to the next after longer times: the slower root `p` of the process, at least
    /// `rho`.
    pub decay: f64,
}

/// Longest gap whose memory is computed, frames.
const MAX_GAP: usize = 10_000;

/// Largest autocorrelation: beyond it level and innovation could not be separated numerically.
const MAX_AUTOCORRELATION: f64 = 0.995;

/// Times over which the decay is measured, s: after what is white and fast, and before few pairs of frames are left.
const DECAY_SECS: [f64; 2] = [1.0 / 6.0, 0.5];

/// Residuals beyond this many standard deviations are not part of the process.
const OUTLIER: f64 = 4.0;

impl NoiseProcess {
    /// Independent errors.
    pub(crate) const WHITE: Self = Self { autocorrelation: 0.0, decay: 0.0 };

    /// From sums of products.
    ///
    /// Where most of the error is white, two frames cannot tell the slow part, and a process with its decay would take white
    /// noise for an alternation from frame to frame. Its second root stays above `-rho`, hence `p <= 2 rho / (1 + rho^2)`.
    pub(crate) fn of(sums: &LagSums) -> Self {
        let measured = |[product, square]: [f64; 2]| {
            if square > 0.0 { (product / square).clamp(0.0, MAX_AUTOCORRELATION) } else { 0.0 }
        };
        let [one, near, far] = sums.sums.map(measured);
        let [_, after_near, after_far] = sums.lags;
        let decay = if near > 0.0 { (far / near).powf(1.0 / (after_far - after_near) as f64) } else { 0.0 };
        let slowest = (2.0 * one / (1.0 + one * one)).min(MAX_AUTOCORRELATION);
        Self { autocorrelation: one, decay: decay.min(slowest).max(one) }
    }

    /// Autocorrelation after some frames.
    pub(crate) fn after(&self, frames: usize) -> f64 {
        let a = self.coefficients();
        let mut last = [1.0, self.autocorrelation];
        for _ in 0..frames {
            last = [last[1], a[0] * last[1] + a[1] * last[0]];
        }
        last[0]
    }

    /// Of every `stride`-th frame.
    fn thinned(&self, stride: usize) -> Self {
        Self { autocorrelation: self.after(stride), decay: self.decay.powi(stride as i32) }
    }

    /// What a frame of a long path says of a constant level of unit variance: the squared sum of the factors of an innovation.
    fn level_information(&self) -> f64 {
        self.innovation([true, true], Some(1)).iter().sum::<f64>().powi(2)
    }

    /// Coefficients `a` of the residuals one and two frames ago: sum and negative product of the roots, the second of which is
    /// `(rho - p) / (1 - rho p)`.
    fn coefficients(&self) -> [f64; 2] {
        let Self { autocorrelation, decay } = *self;
        let second = (autocorrelation - decay) / (1.0 - autocorrelation * decay);
        [decay + second, -decay * second]
    }

    /// Factors of a residual and of the one some frames before it, the only one near it, whose correlation is `rho`; their sum
    /// has unit variance and says of a level what as many frames of a path without holes say.
    ///
    /// The best predictor, `rho` times the earlier one, would say two to four times as much where errors last. Where they do not,
    /// no more can be said than it does.
    fn beside_hole(&self, rho: f64, frames: usize) -> [f64; 2] {
        let information = (frames as f64 * self.level_information()).min((1.0 - rho) / (1.0 + rho));
        // (1 - c)^2 = information (1 + c^2 - 2 c rho).
        let (half, ends) = (1.0 - information * rho, 1.0 - information);
        let c = ends / (half + (half * half - ends * ends).max(0.0).sqrt()).max(f64::MIN_POSITIVE);
        let sigma = (1.0 + c * c - 2.0 * c * rho).max(1e-4).sqrt();
        [1.0 / sigma, -c / sigma]
    }

    /// Factors of the residuals of a frame, the one before and the one before that, given how long ago this keypoint was last
    /// seen: `[seen one frame ago, seen two frames ago]`, and the frames since it was last seen at all.
    pub(crate) fn innovation(&self, [one_ago, two_ago]: [bool; 2], gap: Option<usize>) -> [f64; 3] {
        let a = self.coefficients();
        let [one, two] = [self.after(1), self.after(2)];
        let sigma = |explained: f64| (1.0 - explained).max(1e-4).sqrt();
        match (one_ago, two_ago) {
            (true, true) => {
                let sigma = sigma(a[0] * one + a[1] * two);
                [1.0 / sigma, -a[0] / sigma, -a[1] / sigma]
            }
            (true, false) => {
                let [own, by_one] = self.beside_hole(one, 1);
                [own, by_one, 0.0]
            }
            (false, true) => {
                let [own, by_two] = self.beside_hole(two, 2);
                [own, 0.0, by_two]
            }
            // What was known before the gap is not counted again.
            (false, false) => {
                let memory = gap.map_or(0.0, |gap| self.decay.powi(gap.min(MAX_GAP) as i32));
                [(1.0 - memory * memory).sqrt(), 0.0, 0.0]
            }
        }
    }
}

/// Sums over pairs of residuals that lie one frame, a short and a long time apart: of their products, and of their mean squares.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LagSums {
    /// Frames, ascending.
    lags: [usize; 3],
    sums: [[f64; 2]; 3],
}

impl LagSums {
    /// `frame_interval`: s.
    pub(crate) fn new(frame_interval: f64) -> Self {
        let [near, far] = DECAY_SECS.map(|secs| (secs / frame_interval).round() as usize);
        let near = near.max(1);
        Self { lags: [1, near, far.max(near + 1)], sums: [[0.0; 2]; 3] }
    }

    /// Adds a channel: a run of (frame, standardised residual) of one keypoint in one camera, ascending.
    pub(crate) fn add(&mut self, channel: &[(usize, Vector2<f64>)]) {
        for (lag, sums) in self.lags.into_iter().zip(&mut self.sums) {
            let mut earlier = channel.iter().peekable();
            for (frame, now) in channel {
                while earlier.next_if(|(before, _)| before + lag < *frame).is_some() {}
                let Some((_, before)) = earlier.peek().filter(|(before, _)| before + lag == *frame) else { continue };
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
        for (own, other) in pooled.sums.iter_mut().zip(&others.sums) {
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
    /// How often an innovation counts; 1 where every frame is taken.
    pub weights: Vec<f64>,
}

impl PathNoise {
    /// Of every `stride`-th frame. Innovations count for what the frames between say of a level that hardly changes: `stride`
    /// times where errors are independent, once where they last.
    pub(crate) fn thinned(&self, stride: usize) -> Self {
        let processes: Vec<NoiseProcess> = self.processes.iter().map(|process| process.thinned(stride)).collect();
        let weight = |(all, thinned): (&NoiseProcess, &NoiseProcess)| {
            stride as f64 * all.level_information() / thinned.level_information()
        };
        let weights = self.processes.iter().zip(&processes).map(weight).collect();
        Self { processes, shares: self.shares.clone(), weights }
    }

    /// The medians over the landmarks.
    pub(crate) fn typical(&self) -> NoiseProcess {
        let of = |value: fn(&NoiseProcess) -> f64| {
            median(&mut self.processes.iter().map(value).collect::<Vec<_>>()).unwrap_or(0.0)
        };
        NoiseProcess { autocorrelation: of(|process| process.autocorrelation), decay: of(|process| process.decay) }
    }

    /// The same independent noise for all landmarks.
    pub(crate) fn white(n_landmarks: usize, share: f64) -> Self {
        Self {
            processes: vec![NoiseProcess::WHITE; n_landmarks],
            shares: vec![share; n_landmarks],
            weights: vec![1.0; n_landmarks],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const PROCESS: NoiseProcess = NoiseProcess { autocorrelation: 0.84, decay: 0.95 };

    const INTERVAL: f64 = 1.0 / 30.0;

    fn measured(path: &[(usize, Vector2<f64>)]) -> NoiseProcess {
        let mut sums = LagSums::new(INTERVAL);
        sums.add(path);
        NoiseProcess::of(&sums)
    }

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

    /// 20,000 frames of correlation time 20 know an autocorrelation to 0.03.
    #[test]
    fn process_of_a_path_is_measured() {
        let found = measured(&path(20_000));
        assert!((found.autocorrelation - PROCESS.autocorrelation).abs() < 0.03, "{found:?}");
        assert!((found.decay - PROCESS.decay).abs() < 0.02, "{found:?}");
        assert_eq!(measured(&[]), NoiseProcess::WHITE);
    }

    /// On `hard` and `paper`, mostly white, an unbounded decay made joints a fifth worse.
    #[test]
    fn decay_is_bounded_where_most_is_white() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut slow = Vector2::zeros();
        let mut drawn = || Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let mixed = (0..20_000).map(|t| {
            let (step, white): (Vector2<f64>, Vector2<f64>) = (drawn(), drawn());
            slow = slow * 0.95 + step * (1.0f64 - 0.95 * 0.95).sqrt();
            (t, slow * 0.3f64.sqrt() + white * 0.7f64.sqrt())
        });
        let found = measured(&mixed.collect::<Vec<_>>());
        let bound = 2.0 * found.autocorrelation / (1.0 + found.autocorrelation.powi(2));
        assert!((found.autocorrelation - 0.285).abs() < 0.03 && found.decay == bound, "{found:?}");
    }

    /// The level's variance is one: what the process draws has the variance that a first residual is given.
    #[test]
    fn a_path_of_unit_innovations_has_unit_variance() {
        let path = path(20_000);
        let variance = path.iter().map(|(_, r)| 0.5 * r.norm_squared()).sum::<f64>() / path.len() as f64;
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
    }

    #[test]
    fn autocorrelation_decays_from_its_first_value() {
        assert_eq!([0, 1].map(|lag| PROCESS.after(lag)), [1.0, 0.84]);
        assert!((PROCESS.after(40) / PROCESS.after(39) - 0.95).abs() < 1e-6);
        assert_eq!(NoiseProcess::WHITE.after(2), 0.0);
    }

    /// Every third frame says of a level what all say, whether errors last or not.
    #[test]
    fn thinned_paths_say_as_much_of_a_level() {
        let slow = NoiseProcess { autocorrelation: 0.95, decay: 0.95 };
        for process in [NoiseProcess::WHITE, PROCESS, slow] {
            let noise = PathNoise { processes: vec![process], ..PathNoise::white(1, 1.0) };
            let thinned = noise.thinned(3);
            let said = thinned.weights[0] * thinned.processes[0].level_information();
            assert!((said - 3.0 * process.level_information()).abs() < 1e-12);
        }
        let weight = |process| PathNoise { processes: vec![process], ..PathNoise::white(1, 1.0) }.thinned(3).weights[0];
        assert_eq!(weight(NoiseProcess::WHITE), 3.0);
        assert!(weight(slow) < 1.01, "{}", weight(slow));
    }

    /// A frame with a hole before it counted for up to four.
    #[test]
    fn holes_do_not_add_to_what_is_known_of_a_level() {
        let said = |seen: [bool; 2]| PROCESS.innovation(seen, Some(2)).iter().sum::<f64>().powi(2);
        let [whole, after_hole, next] = [[true, true], [false, true], [true, false]].map(said);
        assert!((after_hole - 2.0 * whole).abs() < 1e-9 && (next - whole).abs() < 1e-9, "{whole} {after_hole} {next}");
        let [_, one, _] = NoiseProcess::WHITE.innovation([true, false], Some(1));
        assert_eq!(one, 0.0);
    }

    #[test]
    fn after_a_gap_only_what_was_forgotten_counts() {
        let weight = |gap: Option<usize>| PROCESS.innovation([false; 2], gap)[0];
        assert_eq!(weight(None), 1.0);
        assert!(weight(Some(3)) < weight(Some(10)) && weight(Some(10)) < weight(Some(1000)));
        assert!((weight(Some(1000)) - 1.0).abs() < 1e-9);
        let white = NoiseProcess::WHITE;
        assert_eq!(white.innovation([true, true], Some(1)), [1.0, 0.0, 0.0]);
        assert_eq!(white.innovation([false, false], Some(5)), [1.0, 0.0, 0.0]);
    }

    /// Few residuals of a landmark are drawn towards those of all.
    #[test]
    fn sparse_landmarks_take_the_process_of_all() {
        let mut all = LagSums::new(INTERVAL);
        all.add(&path(5_000));
        let pooled = NoiseProcess::of(&LagSums::new(INTERVAL).pooled(&all, 100.0));
        assert!((pooled.autocorrelation - NoiseProcess::of(&all).autocorrelation).abs() < 1e-12);
    }
}
