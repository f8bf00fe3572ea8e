//! How many log lines a process sends to the others.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Log lines that a process sends to the others in a second; further ones reach its own clients alone.
const LINES_PER_S: u32 = 10;

const SECOND: Duration = Duration::from_secs(1);

/// Lines of one second.
#[derive(Debug, Default)]
pub(super) struct LineCount(Mutex<Option<(Instant, u32)>>);

impl LineCount {
    /// Counts a line; false where there were enough since the beginning of the second.
    pub(super) fn take(&self, now: Instant) -> bool {
        let mut count = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (since, n) = count.filter(|(since, _)| now.duration_since(*since) < SECOND).unwrap_or((now, 0));
        *count = Some((since, n + 1));
        n < LINES_PER_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_lines_a_second_reach_the_other_processes() {
        let (count, start) = (LineCount::default(), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        let taken = (0..100).filter(|n| count.take(at(10 * n))).count();
        assert_eq!(taken, 10);
        assert!(count.take(at(1000)), "the next second");
    }
}
