//! Rate limits: one token bucket for each tenant or address.

use governor::clock::{Clock, DefaultClock};
use governor::middleware::NoOpMiddleware;
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter as Buckets};
use std::num::NonZeroU32;
use std::time::Duration;

/// Token buckets by key.
pub(super) struct RateLimiter<C: Clock = DefaultClock> {
    buckets: Buckets<String, HashMapStateStore<String>, C, NoOpMiddleware<C::Instant>>,
    clock: C,
}

/// From this number of buckets on, full buckets are removed before a request is counted: memory stays bounded.
const MAX_BUCKETS: usize = 10_000;

/// Longest time between two requests of one key.
const HOUR: Duration = Duration::from_secs(3600);

impl RateLimiter {
    /// Allows each key `per_second` requests on average, and twice as many at once after a pause.
    pub(super) fn new(per_second: f64) -> Self {
        Self::with_clock(per_second, DefaultClock::default())
    }
}

impl<C: Clock + Clone> RateLimiter<C> {
    fn with_clock(per_second: f64, clock: C) -> Self {
        let period = Duration::try_from_secs_f64(per_second.recip()).unwrap_or(HOUR);
        let quota = Quota::with_period(period.clamp(Duration::from_nanos(1), HOUR)).expect("the period is not zero");
        let burst = NonZeroU32::new((2.0 * per_second) as u32).unwrap_or(NonZeroU32::MIN);
        let buckets = Buckets::new(quota.allow_burst(burst), HashMapStateStore::default(), clock.clone());
        Self { buckets, clock }
    }

    /// Takes one token from the bucket of `key`.
    ///
    /// # Errors
    /// Time until the next token.
    pub(super) fn take(&self, key: &str) -> Result<(), Duration> {
        if self.buckets.len() >= MAX_BUCKETS {
            self.buckets.retain_recent();
        }
        self.buckets.check_key(&key.to_owned()).map_err(|refused| refused.wait_time_from(self.clock.now()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use governor::clock::FakeRelativeClock;

    #[test]
    fn allows_a_burst_and_then_the_rate() {
        let clock = FakeRelativeClock::default();
        let limiter = RateLimiter::with_clock(10.0, clock.clone());
        let allowed = || (0..100).filter(|_| limiter.take("a").is_ok()).count();
        assert_eq!(allowed(), 20);
        clock.advance(Duration::from_millis(500));
        assert_eq!(allowed(), 5);
        clock.advance(Duration::from_secs(60));
        assert_eq!(allowed(), 20);
        assert!(limiter.take("b").is_ok(), "each key has its own bucket");
        assert_eq!(limiter.take("a"), Err(Duration::from_millis(100)));
    }
}
