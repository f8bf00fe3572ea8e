//! Random processes in time, sampled once a frame.

use super::random::normal;
use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Gauss-Markov process of mean 0 and variance 1: its values at a distance of $t$ have the correlation $e^{-t/\tau}$.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drift {
    kept: f64,
    fresh: f64,
}

impl Drift {
    /// `tau`: time after which the correlation is 1/e, s.
    pub(super) fn with_time(tau: f64, fps: f64) -> Self {
        Self::with_memory((-1.0 / (tau * fps)).exp())
    }

    /// `kept`: correlation from one frame to the next, 0 to 1.
    pub(super) fn with_memory(kept: f64) -> Self {
        Self { kept, fresh: (1.0 - kept.powi(2)).sqrt() }
    }

    /// The values of the next frame.
    pub(super) fn advance(self, values: &mut [Vector2<f64>], rng: &mut ChaCha8Rng) {
        for value in values {
            *value = *value * self.kept + white(rng) * self.fresh;
        }
    }

    /// The same for numbers.
    pub(super) fn advance_numbers(self, values: &mut [f64], rng: &mut ChaCha8Rng) {
        for value in values {
            *value = *value * self.kept + normal(rng, self.fresh);
        }
    }
}

/// A pixel of independent standard normal coordinates: the first value of a process, and white noise.
pub(super) fn white(rng: &mut ChaCha8Rng) -> Vector2<f64> {
    Vector2::new(normal(rng, 1.0), normal(rng, 1.0))
}

/// A state that begins and ends at random times, such as an outlier that stays; durations are exponential.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Episode {
    is_on: Option<bool>,
}

/// Probabilities per frame that an episode begins and ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Odds {
    begins: f64,
    ends: f64,
}

impl Odds {
    /// Episodes of a mean `duration` (s) that fill `share` of the time, at most 90 %.
    pub(super) fn of_share(share: f64, duration: f64, fps: f64) -> Self {
        let share = share.min(0.9);
        Self::of_rate(share / (1.0 - share) / duration, duration, fps)
    }

    /// Episodes of a mean `duration` (s), of which `per_second` begin in a second without one.
    pub(super) fn of_rate(per_second: f64, duration: f64, fps: f64) -> Self {
        let probability = |rate: f64| 1.0 - (-rate / fps).exp();
        Self { begins: probability(per_second), ends: probability(1.0 / duration) }
    }
}

impl Episode {
    /// Advances by one frame; true if an episode begins. The first frame is on with the share of time that the odds give.
    pub(super) fn advance(&mut self, odds: Odds, rng: &mut ChaCha8Rng) -> bool {
        let was_on = self.is_on();
        let probability = match self.is_on {
            None => odds.begins / (odds.begins + odds.ends),
            Some(false) => odds.begins,
            Some(true) => 1.0 - odds.ends,
        };
        self.is_on = Some(rng.random::<f64>() < probability);
        self.is_on() && !was_on
    }

    pub(super) fn is_on(self) -> bool {
        self.is_on == Some(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn drift_has_unit_variance_and_the_given_time() {
        let (mut rng, drift) = (ChaCha8Rng::seed_from_u64(1), Drift::with_time(0.5, 20.0));
        let mut values = vec![white(&mut rng); 20_000];
        for _ in 0..100 {
            drift.advance(&mut values, &mut rng);
        }
        let before = values.clone();
        for _ in 0..10 {
            drift.advance(&mut values, &mut rng);
        }
        let mean = |product: &dyn Fn(usize) -> f64| (0..values.len()).map(product).sum::<f64>() / values.len() as f64;
        // 20,000 numbers: one standard error is 0.01 of a variance, 0.007 of a covariance.
        assert!((mean(&|i| values[i].x * values[i].x) - 1.0).abs() < 0.04);
        assert!((mean(&|i| values[i].x * before[i].x) - (-1.0_f64).exp()).abs() < 0.03);
    }

    #[test]
    fn episodes_have_the_given_share_and_duration() {
        for fps in [25.0, 60.0] {
            let (mut rng, odds) = (ChaCha8Rng::seed_from_u64(2), Odds::of_share(0.2, 0.5, fps));
            let (mut episode, mut n_on, mut n_begun) = (Episode::default(), 0.0, 0.0);
            let n = 200_000;
            for _ in 0..n {
                n_begun += f64::from(u8::from(episode.advance(odds, &mut rng)));
                n_on += f64::from(u8::from(episode.is_on()));
            }
            let (share, duration) = (n_on / f64::from(n), n_on / n_begun / fps);
            // Some 1,300 episodes or more: one standard error is 3 %. A duration lasts to the end of its frame.
            assert!((share - 0.2).abs() < 0.02, "{share} of the time at {fps} Hz");
            assert!((duration - 0.5 - 0.5 / fps).abs() < 0.05, "{duration} s at {fps} Hz");
        }
    }
}
