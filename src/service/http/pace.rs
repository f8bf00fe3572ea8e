//! How often somebody may ask: one token bucket each.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Buckets of everybody who has asked lately.
pub(super) struct Pace {
    per_second: f64,
    burst: f64,
    buckets: Mutex<BTreeMap<String, Bucket>>,
}

struct Bucket {
    tokens: f64,
    filled: Instant,
}

/// Above so many buckets the full ones are forgotten; a stranger cannot fill the memory.
const MAX_BUCKETS: usize = 10_000;

impl Pace {
    /// `per_second` requests, and twice as many at once after a pause.
    pub(super) fn new(per_second: f64) -> Self {
        Self { per_second, burst: (2.0 * per_second).max(1.0), buckets: Mutex::default() }
    }

    /// Takes one token of `who`.
    ///
    /// # Errors
    /// How long to wait for the next.
    pub(super) fn take(&self, who: &str) -> Result<(), Duration> {
        self.take_at(who, Instant::now())
    }

    fn take_at(&self, who: &str, now: Instant) -> Result<(), Duration> {
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        if buckets.len() >= MAX_BUCKETS && !buckets.contains_key(who) {
            buckets.retain(|_, bucket| self.filled(bucket, now) < self.burst);
        }
        let bucket = buckets.entry(who.to_owned()).or_insert(Bucket { tokens: self.burst, filled: now });
        bucket.tokens = self.filled(bucket, now);
        bucket.filled = now;
        if bucket.tokens < 1.0 {
            return Err(Duration::from_secs_f64(((1.0 - bucket.tokens) / self.per_second).min(3600.0)));
        }
        bucket.tokens -= 1.0;
        Ok(())
    }

    fn filled(&self, bucket: &Bucket, now: Instant) -> f64 {
        (bucket.tokens + self.per_second * now.duration_since(bucket.filled).as_secs_f64()).min(self.burst)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_allowed_and_then_the_rate() {
        let pace = Pace::new(10.0);
        let start = Instant::now();
        let allowed = |at: Duration| (0..100).filter(|_| pace.take_at("a", start + at).is_ok()).count();
        assert_eq!(allowed(Duration::ZERO), 20);
        assert_eq!(allowed(Duration::from_millis(500)), 5);
        assert_eq!(allowed(Duration::from_secs(60)), 20);
        assert!(pace.take_at("b", start).is_ok(), "another one's bucket is another");
        assert_eq!(pace.take_at("a", start + Duration::from_secs(60)), Err(Duration::from_millis(100)));
    }
}
