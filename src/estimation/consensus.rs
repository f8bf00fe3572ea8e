//! Random sample consensus with a soft score, local optimisation and early rejection.
//!
//! Score: `sum_i w_i max(0, 1 - d_i^2 / threshold^2)`, the truncated quadratic of MSAC (Torr and Zisserman, CVIU 2000,
//! Sec. 4) expressed as a gain. Every new best model is re-fitted to the data (Chum, Matas, Kittler, "Locally optimized
//! RANSAC", 2003).

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The data of a consensus search, their weights and tolerance, and its limits.
#[derive(Debug, Clone, Copy)]
pub struct ConsensusProblem<'a> {
    /// Number of data.
    pub n_data: usize,
    /// Weight of each datum, not negative; `None`: all 1.
    pub weights: Option<&'a [f64]>,
    /// Distance at which the gain of a datum reaches zero, in the unit of the distances.
    pub threshold: f64,
    /// Greatest number of samples drawn.
    pub iterations: usize,
    /// Seed of the draws: the same seed and data give the same model.
    pub seed: u64,
}

/// The best model and its score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consensus<Model> {
    /// The model.
    pub model: Model,
    /// Its score, at most the sum of all weights.
    pub score: f64,
}

/// Probability that the search has missed the best model when it ends early, at most.
const MISS_PROBABILITY: f64 = 1e-3;

/// Factor on the number of samples that finds an outlier-free one: minimal samples are noisy, and not every outlier-free
/// one gives a good model.
const SAMPLES_FACTOR: f64 = 3.0;

/// Number of data after which a score is compared with the best one.
const BLOCK: usize = 16;

/// `sqrt(ln(1 / delta) / 2)` of Hoeffding's inequality for `delta = 1e-3`: a model as good as the best one is rejected
/// early with at most that probability at each comparison.
const HOEFFDING: f64 = 1.858;

/// Finds the model with the highest score among those of random samples of `SIZE` data; `None` where all scores are zero.
///
/// `solve`: the models of a minimal sample (indices of data). `squared_distance`: of a datum to a model; infinite for
/// inadmissible ones. `refit`: improves a model on all data.
pub fn find_consensus<Model: Copy, const SIZE: usize>(
    problem: &ConsensusProblem<'_>,
    solve: impl Fn(&[usize; SIZE]) -> Vec<Model>,
    squared_distance: impl Fn(&Model, usize) -> f64,
    refit: impl Fn(&Model) -> Model,
) -> Option<Consensus<Model>> {
    let mut rng = ChaCha8Rng::seed_from_u64(problem.seed);
    let data = SampleOrder::shuffled(problem, &mut rng)?;
    if data.order.len() < SIZE {
        return None;
    }
    let mut best: Option<Consensus<Model>> = None;
    let mut drawn = 0;
    while drawn < enough_samples(problem.iterations, SIZE, best.as_ref().map_or(0.0, |b| b.score) / data.total) {
        drawn += 1;
        for model in solve(&data.draw(&mut rng)) {
            let minimum_score = best.as_ref().map_or(0.0, |b| b.score);
            let Some(score) = data.score_above(minimum_score, |datum| squared_distance(&model, datum)) else {
                continue;
            };
            let refitted = refit(&model);
            let improved = data.score_above(score, |datum| squared_distance(&refitted, datum));
            best = Some(match improved {
                Some(score) => Consensus { model: refitted, score },
                None => Consensus { model, score },
            });
        }
    }
    best
}

/// `ln(miss) / ln(1 - share^size)`, times [`SAMPLES_FACTOR`], within `limit`.
fn enough_samples(limit: usize, size: usize, share: f64) -> usize {
    let outlier_free = share.clamp(0.0, 1.0).powi(size as i32);
    // Infinite for a share of zero, zero for a share of one.
    let enough = SAMPLES_FACTOR * MISS_PROBABILITY.ln() / (-outlier_free).ln_1p();
    limit.min(enough.ceil().max(1.0) as usize)
}

/// The data of positive weight in random order, so that every prefix is a random sample of all data.
struct SampleOrder {
    order: Vec<usize>,
    /// Weight of each datum, in this order.
    gain_limit: Vec<f64>,
    /// Sum of the weights of each whole number of blocks.
    weight_before: Vec<f64>,
    /// Square root of the sum of the squared weights, likewise.
    spread_before: Vec<f64>,
    total: f64,
    inverse_threshold2: f64,
}

impl SampleOrder {
    fn shuffled(problem: &ConsensusProblem<'_>, rng: &mut ChaCha8Rng) -> Option<Self> {
        let weight = |datum: usize| problem.weights.map_or(1.0, |w| w.get(datum).copied().unwrap_or(0.0));
        let mut order: Vec<usize> = (0..problem.n_data).filter(|&datum| weight(datum) > 0.0).collect();
        order.shuffle(rng);
        let gain_limit: Vec<f64> = order.iter().map(|&datum| weight(datum)).collect();
        let (mut weight_before, mut spread_before, mut total, mut squares) = (vec![0.0], vec![0.0], 0.0, 0.0_f64);
        for block in gain_limit.chunks(BLOCK) {
            total += block.iter().sum::<f64>();
            squares += block.iter().map(|w| w * w).sum::<f64>();
            weight_before.push(total);
            spread_before.push(squares.sqrt());
        }
        let inverse_threshold2 = 1.0 / (problem.threshold * problem.threshold);
        let usable = total > 0.0 && total.is_finite() && inverse_threshold2.is_finite();
        usable.then_some(Self { order, gain_limit, weight_before, spread_before, total, inverse_threshold2 })
    }

    fn draw<const SIZE: usize>(&self, rng: &mut ChaCha8Rng) -> [usize; SIZE] {
        let mut sample = [0; SIZE];
        for k in 0..SIZE {
            // The k-th of the remaining positions: skips those taken, in ascending order.
            let mut position = rng.random_range(0..self.order.len() - k);
            let mut at = 0;
            while at < k && sample[at] <= position {
                position += 1;
                at += 1;
            }
            sample.copy_within(at..k, at + 1);
            sample[at] = position;
        }
        sample.map(|position| self.order[position])
    }

    /// The score if it is above `minimum_score`; `None` as soon as it cannot be or, by Hoeffding's bound, probably is not.
    fn score_above(&self, minimum_score: f64, squared_distance: impl Fn(usize) -> f64) -> Option<f64> {
        let share = minimum_score / self.total;
        let mut score = 0.0;
        for (block, data) in self.order.chunks(BLOCK).enumerate() {
            let (weight, spread) = (self.weight_before[block], self.spread_before[block]);
            if score + (self.total - weight) <= minimum_score || score < share * weight - HOEFFDING * spread {
                return None;
            }
            for (&datum, limit) in data.iter().zip(&self.gain_limit[block * BLOCK..]) {
                score += limit * (1.0 - squared_distance(datum) * self.inverse_threshold2).max(0.0);
            }
        }
        (score > minimum_score).then_some(score)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line through the origin among points of which every second is noise.
    #[test]
    fn finds_a_line_among_half_outliers() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let points: Vec<[f64; 2]> = (0..200)
            .map(|i| {
                let x = rng.random_range(1.0..5.0);
                [x, if i % 2 == 0 { 0.7 * x } else { rng.random_range(-9.0..9.0) }]
            })
            .collect();
        let problem = ConsensusProblem { n_data: 200, weights: None, threshold: 0.1, iterations: 200, seed: 0 };
        let distance = |slope: &f64, i: usize| (points[i][1] - slope * points[i][0]).powi(2);
        let found = find_consensus(&problem, |&[i]| vec![points[i][1] / points[i][0]], distance, |m| *m).unwrap();
        assert!((found.model - 0.7).abs() < 1e-12);
        assert!(found.score >= 100.0 - 1e-9);
        let blind = vec![0.0; 200];
        let problem = ConsensusProblem { weights: Some(&blind), ..problem };
        assert!(find_consensus(&problem, |&[_]| vec![0.7], distance, |m| *m).is_none());
    }

    #[test]
    fn samples_hold_every_datum_once() {
        let problem = ConsensusProblem { n_data: 6, weights: None, threshold: 1.0, iterations: 1, seed: 0 };
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let data = SampleOrder::shuffled(&problem, &mut rng).unwrap();
        let mut seen = [0; 6];
        for _ in 0..600 {
            let mut sample: [usize; 5] = data.draw(&mut rng);
            sample.sort();
            assert!(sample.windows(2).all(|w| w[0] < w[1]));
            sample.iter().for_each(|&i| seen[i] += 1);
        }
        assert!(seen.iter().all(|&n| (450..=550).contains(&n)), "each is drawn in five of six samples: {seen:?}");
    }

    #[test]
    fn fewer_outliers_need_fewer_samples() {
        assert_eq!(enough_samples(1000, 5, 0.0), 1000);
        assert_eq!(enough_samples(1000, 5, 1.0), 1);
        assert_eq!(enough_samples(1000, 5, 0.7), 113);
    }
}
