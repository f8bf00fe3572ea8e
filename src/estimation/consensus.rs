//! Random sample consensus with a soft score, local optimisation and early rejection.
//!
//! Score: `sum_i w_i max(0, 1 - d_i^2 / threshold^2)`, the truncated quadratic of MSAC (Torr and Zisserman, CVIU 2000,
//! Sec. 4) turned into a gain. Every new best model is re-fitted to the data before it is believed (Chum, Matas,
//! Kittler, "Locally optimized RANSAC", 2003).

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What is searched: how many data there are, what each is worth, and when one is explained.
#[derive(Debug, Clone, Copy)]
pub struct ConsensusProblem<'a> {
    /// Number of data.
    pub n_data: usize,
    /// Worth of each datum, not negative; `None`: all 1.
    pub weights: Option<&'a [f64]>,
    /// Distance at which a datum's gain reaches zero, in the unit of the distances.
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

/// The best model has been missed with less than this probability when the search ends early.
const MISS_PROBABILITY: f64 = 1e-3;

/// Minimal samples are noisy and not every pure one gives a good model: that many times more are drawn than purity asks.
const CAUTION: f64 = 3.0;

/// A score is compared with the best one after every so many data.
const BLOCK: usize = 16;

/// `sqrt(ln(1 / delta) / 2)` of Hoeffding's inequality for `delta = 1e-3`: a model as good as the best one is dropped
/// early with no more than that probability at each comparison.
const HOEFFDING: f64 = 1.858;

/// Draws samples of `SIZE` data, takes their models, keeps the best; `None` where no model explains anything.
///
/// `solve`: the models of a minimal sample (indices of data). `squared_distance`: of a datum to a model; infinite for
/// inadmissible ones. `refit`: a model improved on all data.
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

/// `ln(miss) / ln(1 - share^size)`, times [`CAUTION`], within `limit`.
fn enough_samples(limit: usize, size: usize, share: f64) -> usize {
    let pure = share.clamp(0.0, 1.0).powi(size as i32);
    // Infinite for a share of zero, zero for a share of one.
    let enough = CAUTION * MISS_PROBABILITY.ln() / (-pure).ln_1p();
    limit.min(enough.ceil().max(1.0) as usize)
}

/// The data of positive weight in random order, so that every prefix is a fair poll of the whole.
struct SampleOrder {
    order: Vec<usize>,
    gain_limit: Vec<f64>,
    /// Sum of the weights of each whole number of blocks.
    weight_before: Vec<f64>,
    /// Square root of the sum of their squares.
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
            // The k-th of the remaining places: steps over those taken, in ascending order.
            let mut place = rng.random_range(0..self.order.len() - k);
            let mut at = 0;
            while at < k && sample[at] <= place {
                place += 1;
                at += 1;
            }
            sample.copy_within(at..k, at + 1);
            sample[at] = place;
        }
        sample.map(|place| self.order[place])
    }

    /// The whole score if it is above `minimum_score`; gives up as soon as it cannot, or by Hoeffding's bound will hardly, be.
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
    fn half_the_data_outvote_the_other_half() {
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
    fn a_sample_never_holds_a_datum_twice() {
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
    fn purer_data_need_fewer_samples() {
        assert_eq!(enough_samples(1000, 5, 0.0), 1000);
        assert_eq!(enough_samples(1000, 5, 1.0), 1);
        assert_eq!(enough_samples(1000, 5, 0.7), 113);
    }
}
