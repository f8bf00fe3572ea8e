//! The wall clock as the service has seen it. A clock that jumps far ahead while the service is stopped must not make every
//! job look old; nothing is removed by age until the new time is confirmed by a week of running.

use super::database::Store;
use super::error::StoreError;
use std::time::{SystemTime, UNIX_EPOCH};

/// Longest stop of a service after which the clock is trusted without confirmation, s: a weekend.
const LONGEST_STOP_S: i64 = 3 * 86_400;

/// Seconds that the service runs with an implausible clock until it is trusted: time for the operator to correct it.
const CONFIRMATION_S: i64 = 7 * 86_400;

/// What the database knows about the clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SeenClock {
    /// Latest plausible time, Unix seconds.
    seen_at: i64,
    /// Seconds that the service has run with an implausible clock.
    suspect_s: i64,
}

/// The clock is too far ahead of the last time that the service has seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SuspectClock {
    /// Days between the clock and the last time seen.
    pub(crate) days_ahead: i64,
    /// Hours of running until the clock is trusted.
    pub(crate) hours_left: i64,
}

impl SeenClock {
    /// The knowledge after the clock has shown `now`, `ran_s` seconds of running after the last call.
    fn next(self, now: i64, ran_s: i64) -> Self {
        let suspect_s = self.suspect_s + ran_s;
        if now <= self.seen_at + LONGEST_STOP_S || suspect_s >= CONFIRMATION_S {
            return Self { seen_at: self.seen_at.max(now), suspect_s: 0 };
        }
        Self { suspect_s, ..self }
    }

    fn suspicion(self, now: i64) -> Option<SuspectClock> {
        let ahead_s = now - self.seen_at;
        (ahead_s > LONGEST_STOP_S).then(|| SuspectClock {
            days_ahead: ahead_s / 86_400,
            hours_left: (CONFIRMATION_S - self.suspect_s) / 3600,
        })
    }
}

/// Reads the wall clock and stores it. `ran_s`: seconds since the last call of this process, 0 in the first.
///
/// # Errors
/// When the store fails.
pub(crate) async fn observe(store: &Store, ran_s: i64) -> Result<Option<SuspectClock>, StoreError> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs() as i64);
    let mut transaction = store.write_relaxed().await?;
    let known = sqlx::query_as::<_, (i64, i64)>("SELECT seen_at, suspect_s FROM clock");
    let known = known.fetch_optional(&mut *transaction).await?;
    let known =
        known.map_or(SeenClock { seen_at: now, suspect_s: 0 }, |(seen_at, suspect_s)| SeenClock { seen_at, suspect_s });
    let next = known.next(now, ran_s);
    sqlx::query(
        "INSERT INTO clock (id, seen_at, suspect_s) VALUES (1, $1, $2)
         ON CONFLICT (id) DO UPDATE SET seen_at = excluded.seen_at, suspect_s = excluded.suspect_s",
    )
    .bind(next.seen_at)
    .bind(next.suspect_s)
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await?;
    Ok(next.suspicion(now))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: i64 = 86_400;

    #[test]
    fn accepts_a_clock_after_a_short_stop_or_a_correction() {
        let clock = SeenClock { seen_at: 1000 * DAY, suspect_s: 0 };
        assert_eq!(clock.next(1002 * DAY, 0), SeenClock { seen_at: 1002 * DAY, suspect_s: 0 });
        assert_eq!(clock.next(5 * DAY, 0), clock, "a clock that was set back loses nothing");
        let suspect = SeenClock { suspect_s: 7, ..clock };
        assert_eq!(suspect.next(1001 * DAY, 5), SeenClock { seen_at: 1001 * DAY, suspect_s: 0 });
    }

    #[test]
    fn distrusts_a_jump_until_a_week_has_run() {
        let mut clock = SeenClock { seen_at: 1000 * DAY, suspect_s: 0 };
        let mut now = 4650 * DAY;
        for _ in 0..6 {
            clock = clock.next(now, DAY);
            assert!(clock.suspicion(now).is_some_and(|suspect| suspect.days_ahead >= 3650), "{clock:?}");
            now += DAY;
        }
        clock = clock.next(now, DAY);
        assert_eq!((clock.seen_at, clock.suspicion(now)), (now, None));
    }
}
