//! Supervision of cases: catches panics, detects hangs and measures memory.

use super::corpus::Input;
use super::targets::Outcome;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A case that runs longer than this hangs.
const HANG: Duration = Duration::from_secs(30);

/// Watches the current case from another thread.
pub(crate) struct Watch {
    current: Arc<Mutex<Option<(Instant, Input)>>>,
}

impl Watch {
    /// Starts the watching thread. A case that hangs is saved in `failures` and ends the process.
    pub(crate) fn start(failures: &Path) -> Self {
        let current: Arc<Mutex<Option<(Instant, Input)>>> = Arc::default();
        let (watched, failures) = (current.clone(), failures.to_owned());
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_secs(1));
                if Arc::strong_count(&watched) == 1 {
                    return; // the run has ended
                }
                let watched = watched.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some((started, case)) = watched.as_ref().filter(|(started, _)| started.elapsed() > HANG) {
                    println!("FAILED a hang of {:.0} s: {:?}", started.elapsed().as_secs_f64(), case.write(&failures));
                    std::process::exit(1);
                }
            }
        });
        Self { current }
    }

    /// Runs a case and returns its outcome, or a description of the defect.
    pub(crate) fn run(&self, case: &Input, read: impl FnOnce() -> Result<Outcome, String>) -> Result<Outcome, String> {
        self.set(Some((Instant::now(), case.clone())));
        let outcome = catch_unwind(AssertUnwindSafe(read));
        self.set(None);
        outcome.unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Err(format!("a panic: {}", text.unwrap_or_default()))
        })
    }

    fn set(&self, case: Option<(Instant, Input)>) {
        *self.current.lock().unwrap_or_else(PoisonError::into_inner) = case;
    }
}

/// Processor time of this thread; `None` if the system does not report it.
pub(crate) fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(Duration::from_nanos(text.split_whitespace().next()?.parse().ok()?))
}

/// Resets the peak memory of this process and returns its current memory, KiB; `None` if the system does not report it.
pub(crate) fn reset_peak() -> Option<u64> {
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    status_kib("VmRSS:")
}

/// Growth of the peak memory above `before`, KiB.
pub(crate) fn growth_kib(before: Option<u64>) -> u64 {
    before.zip(status_kib("VmHWM:")).map_or(0, |(before, peak)| peak.saturating_sub(before))
}

fn status_kib(field: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix(field))?.trim().strip_suffix(" kB")?.parse().ok()
}
