//! Named points between two steps at which the crash harness ends the process, so that "between step i and i + 1" is no luck.
//!
//! `WANDLESS_FAILPOINT=name` ends it at the first pass of that point, `name:3` at the third. Without the feature
//! `failpoints` a point is nothing.

/// Every point, in the order of a job's life.
pub const FAILPOINTS: [&str; 18] = [
    "upload.spooled",
    "upload.synced",
    "upload.published",
    "upload.recorded",
    "enqueue.inserted",
    "enqueue.committed",
    "claim.updated",
    "claim.committed",
    "child.started",
    "child.ended",
    "result.hashed",
    "result.published",
    "finish.written",
    "finish.committed",
    "cancel.committed",
    "delete.committed",
    "recover.committed",
    "recover.swept",
];

/// Ends the process where the harness has asked for it.
#[cfg(not(feature = "failpoints"))]
#[inline]
pub(crate) fn failpoint(_name: &str) {}

/// Ends the process where the harness has asked for it.
#[cfg(feature = "failpoints")]
pub(crate) fn failpoint(name: &str) {
    use std::sync::atomic::{AtomicU32, Ordering};
    static PASSES: AtomicU32 = AtomicU32::new(0);
    debug_assert!(FAILPOINTS.contains(&name), "{name} is in the list");
    let Ok(asked) = std::env::var("WANDLESS_FAILPOINT") else { return };
    let (point, pass) = asked.split_once(':').unwrap_or((&asked, "1"));
    if point == name && PASSES.fetch_add(1, Ordering::SeqCst) + 1 == pass.parse().unwrap_or(1) {
        eprintln!("failpoint {name}");
        let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    }
}
