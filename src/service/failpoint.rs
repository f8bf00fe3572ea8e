//! Where the checks of the service may hurt it: points at which the process dies, and faults that break a promise.
//!
//! `WANDLESS_FAILPOINT=name` ends the process at the first pass of that point, `name:3` at the third, so that "between step
//! i and i + 1" is no luck. `WANDLESS_FAULT=name` breaks one promise, so that a check which does not notice is known to be
//! blind (`checks/service/selftest.py`). `WANDLESS_LINGER_MS=150` makes every stage of the work begin with a pause. Without the feature `failpoints` all are nothing.

/// Every point, in the order of a job's life.
pub const FAILPOINTS: [&str; 36] = [
    "start.locked",
    "start.migrated",
    "recover.updated",
    "recover.committed",
    "recover.swept",
    "upload.spooled",
    "upload.synced",
    "publish.renamed",
    "upload.published",
    "upload.recorded",
    "session.marked",
    "session.committed",
    "session.removed",
    "enqueue.inserted",
    "enqueue.committed",
    "claim.updated",
    "claim.committed",
    "child.started",
    "progress.noted",
    "child.ended",
    "result.hashed",
    "result.published",
    "finish.written",
    "finish.filled",
    "finish.committed",
    "finish.cleared",
    "cancel.marked",
    "cancel.committed",
    "delete.marked",
    "delete.committed",
    "delete.removed",
    "webhook.due",
    "webhook.called",
    "webhook.noted",
    "stop.drained",
    "stop.closed",
];

/// Every fault, and what it does.
pub const FAULTS: [(&str, &str); 31] = [
    ("enqueue.early", "a job is answered 202 before its row is committed"),
    ("publish.late", "a job is succeeded before its files lie where its rows say"),
    ("recovery.blames", "a death of the service is counted as one of the job"),
    ("recovery.forgets", "what ran when the service died is not put back"),
    ("checkpoint.ignored", "a finished stage is run again"),
    ("deaths.uncounted", "a job's own deaths are not counted"),
    ("silence.tolerated", "a silent child is not killed"),
    ("cancel.deaf", "a running job does not hear that it is canceled"),
    ("stop.endless", "a stop waits for every connection"),
    ("lock.none", "a second service may open the data folder"),
    ("busy.impatient", "a database that is held is not waited for"),
    ("disk.unnamed", "a full disk is an internal error"),
    ("claim.clocked", "jobs that the clock says are of the future are not claimed"),
    ("body.patient", "an upload may take for ever"),
    ("key.ignored", "an Idempotency-Key is not looked at"),
    ("range.shifted", "a part of a file begins one byte too late"),
    ("leavers.kept", "an answer to somebody who is gone is still counted as held"),
    ("guesses.free", "wrong keys may be tried without end"),
    ("length.unread", "a Content-Length is not looked at"),
    ("claims.scanned", "the claim has no index"),
    ("answers.slow", "a job is looked up slowly"),
    ("start.slow", "a start takes three seconds"),
    ("limits.none", "an upload may unpack to anything"),
    ("tenants.one", "every key is one of the tenant `default`"),
    ("keys.kept", "revoking a key does nothing"),
    ("webhooks.anywhere", "a webhook may call inside"),
    ("quota.none", "a tenant may fill the disk"),
    ("verify.blind", "a changed file is not noticed"),
    ("backup.short", "a backup leaves a file out"),
    ("damage.silent", "a lost database is replaced by an empty one"),
    ("seed.random", "the seed of a job is another each time"),
];

/// Ends the process where a check has asked for it.
#[cfg(not(feature = "failpoints"))]
#[inline]
pub(crate) fn failpoint(_name: &str) {}

/// Ends the process where a check has asked for it.
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

/// Waits where a stage begins, as long as a check has asked for, so that a kill can meet it.
pub(crate) fn linger() {
    #[cfg(feature = "failpoints")]
    if let Some(milliseconds) = std::env::var("WANDLESS_LINGER_MS").ok().and_then(|asked| asked.parse().ok()) {
        std::thread::sleep(std::time::Duration::from_millis(milliseconds));
    }
}

/// Whether a check has asked for this fault.
#[cfg(not(feature = "failpoints"))]
#[inline]
pub(crate) const fn fault(_name: &str) -> bool {
    false
}

/// Whether a check has asked for this fault.
#[cfg(feature = "failpoints")]
pub(crate) fn fault(name: &str) -> bool {
    debug_assert!(FAULTS.iter().any(|(known, _)| *known == name), "{name} is in the list");
    std::env::var("WANDLESS_FAULT").is_ok_and(|asked| asked == name)
}
