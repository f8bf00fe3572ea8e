//! Watching a case: panics are caught, hangs are told, memory is measured.

use super::corpus::Input;
use super::targets::Outcome;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A case that has not ended by then never will.
const HANG: Duration = Duration::from_secs(30);

/// Looks on from another thread.
pub(super) struct Watch {
    at_work: Arc<Mutex<Option<(Instant, Input)>>>,
}

impl Watch {
    /// Starts looking; a case that hangs is written below `found` and ends the process.
    pub(super) fn start(found: &Path) -> Self {
        let at_work: Arc<Mutex<Option<(Instant, Input)>>> = Arc::default();
        let (seen, found) = (at_work.clone(), found.to_owned());
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_secs(1));
                if Arc::strong_count(&seen) == 1 {
                    return; // nobody runs cases any more
                }
                let seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some((begun, case)) = seen.as_ref().filter(|(begun, _)| begun.elapsed() > HANG) {
                    println!("FOUND a hang of {:.0} s: {:?}", begun.elapsed().as_secs_f64(), case.write(&found));
                    std::process::exit(1);
                }
            }
        });
        Self { at_work }
    }

    /// What came of the case; what was wrong with it where something was.
    pub(super) fn run(&self, case: &Input, read: impl FnOnce() -> Result<Outcome, String>) -> Result<Outcome, String> {
        self.set(Some((Instant::now(), case.clone())));
        let outcome = catch_unwind(AssertUnwindSafe(read));
        self.set(None);
        outcome.unwrap_or_else(|panic| {
            let said = panic.downcast_ref::<String>().cloned();
            let said = said.or_else(|| panic.downcast_ref::<&str>().map(|words| (*words).to_owned()));
            Err(format!("a panic: {}", said.unwrap_or_default()))
        })
    }

    fn set(&self, case: Option<(Instant, Input)>) {
        *self.at_work.lock().unwrap_or_else(PoisonError::into_inner) = case;
    }
}

/// What this thread has had of a processor; `None` where the system does not tell.
pub(super) fn processor_time() -> Option<Duration> {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(Duration::from_nanos(told.split_whitespace().next()?.parse().ok()?))
}

/// Forgets the peak of this process's memory and gives what it takes now, KiB; `None` where the system does not tell.
pub(super) fn forget_peak() -> Option<u64> {
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    status_kib("VmRSS:")
}

/// How far the peak has risen above `before`, KiB.
pub(super) fn growth_kib(before: Option<u64>) -> u64 {
    before.zip(status_kib("VmHWM:")).map_or(0, |(before, peak)| peak.saturating_sub(before))
}

fn status_kib(field: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix(field))?.trim().strip_suffix(" kB")?.parse().ok()
}
