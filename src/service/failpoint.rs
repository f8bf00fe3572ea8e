//! Fault injection for the checks of the service: points at which the process is killed, and faults that break a guarantee.
//!
//! `WANDLESS_FAILPOINT=name` kills the process at the first pass of that point, `name:3` at the third, so that the moment
//! between step i and i + 1 is met every time. `WANDLESS_FAULT=name` breaks one guarantee, so that a check that does not
//! notice is known to be ineffective (`checks/service/selftest.py`). `WANDLESS_LINGER_MS=150` delays the start of every
//! stage of a job. `WANDLESS_LOST_ANSWERS=3` makes one in three COMMITs of sessions and jobs look failed although it was made.
//! `WANDLESS_SIMULATED_JOB=500:FOLDER` makes a job wait for 500 ms and publish the files of a folder in place of solving its session.
//! `WANDLESS_STANDSTILL=name` stops the process (SIGSTOP) whenever it passes that point, until a check lets it go on.
//! `WANDLESS_SWEEP_S=2` is the time between two sweeps of the object store. `WANDLESS_NEXT_RELEASE=1` makes this program the
//! release after itself: its API nodes write an option that this release does not know, and its workers read it.
//! Without the feature `failpoints` none of these variables has an effect.

/// Names of all failpoints, in the order of a job's life.
pub const FAILPOINTS: [&str; 40] = [
    "start.locked", "create.written", "create.named", "start.migrated", "recover.updated", "recover.committed",
    "recover.swept", "upload.spooled", "upload.synced", "publish.renamed", "upload.published", "upload.recorded",
    "session.marked", "session.committed", "session.removed", "enqueue.inserted", "enqueue.committed", "claim.updated",
    "claim.committed", "child.started", "progress.noted", "child.ended", "result.hashed", "result.published",
    "finish.filled", "finish.written", "finish.committed", "finish.cleared", "cancel.marked", "cancel.committed",
    "delete.marked", "delete.committed", "delete.removed", "exports.written", "exports.committed", "webhook.due",
    "webhook.called", "webhook.noted", "stop.drained", "stop.closed",
];

/// Names of all faults, and what each does.
pub const FAULTS: &[(&str, &str)] = &[
    ("enqueue.early", "a job is answered 202 before its row is committed"),
    ("publish.late", "a job is succeeded before its files are in their folder"),
    ("recovery.blames", "a crash of the service is counted as a crash of the job"),
    ("recovery.forgets", "jobs that ran when the service crashed are not requeued"),
    ("checkpoint.ignored", "a finished stage is run again"),
    ("crashes.uncounted", "crashes of a job's process are not counted"),
    ("silence.tolerated", "a silent child process is not killed"),
    ("cancel.deaf", "a running job ignores a cancel"),
    ("stop.endless", "a stop waits for every connection"),
    ("lock.none", "a second service can open the data folder"),
    ("busy.impatient", "a locked database fails immediately"),
    ("disk.unnamed", "a full disk is reported as an internal error"),
    ("claim.clocked", "jobs dated in the future are not claimed"),
    ("body.patient", "an upload can take unlimited time"),
    ("key.ignored", "an Idempotency-Key is ignored"),
    ("range.shifted", "a part of a file begins one byte too late"),
    ("leavers.kept", "an answer to a disconnected client is still counted as held"),
    ("guesses.free", "wrong keys can be tried without limit"),
    ("length.unread", "a Content-Length is ignored"),
    ("claims.scanned", "the claim has no index"),
    ("answers.slow", "looking up a job is slow"),
    ("start.slow", "a start takes three seconds"),
    ("limits.none", "an upload can unpack to any size"),
    ("tenants.one", "every key belongs to the tenant `default`"),
    ("keys.kept", "revoking a key has no effect"),
    ("webhooks.anywhere", "a webhook can call private addresses"),
    ("quota.none", "a tenant can fill the disk"),
    ("disk.unwatched", "jobs run and fail on a full disk"),
    ("pages.unbounded", "a page of a list can have any size"),
    ("arrivals.uncounted", "uploads count only after their last byte"),
    ("verify.blind", "a changed file is not detected"),
    ("backup.short", "a backup omits a file"),
    ("damage.silent", "a lost database is replaced by an empty one"),
    ("commit.forgotten", "a repeated report of a recorded result counts as lost"),
    ("seed.random", "the seed of a job differs in every run"),
    ("uploads.unlimited", "an upload is validated without a memory limit"),
    ("uploads.spilled", "an upload leaves a file beside the data folder"),
    ("webhooks.unfair", "webhooks are called in the order of their creation"),
    ("children.free", "a job's process is not confined"),
    ("descriptors.unreserved", "connections can take every file descriptor"),
    ("idlers.kept", "idle connections keep their slots"),
    ("hosts.any", "a service without keys answers requests to any host"),
    ("fence.none", "a claim that was put back can still publish"),
    ("beat.none", "workers send no beats"),
    ("sweep.eager", "the sweep removes objects that rows name"),
    ("row.unlocked", "claims do not wait for each other's tenant"),
    ("drain.abrupt", "a stopping node closes the idle connections of its proxy at once"),
    ("origins.any", "pages of other sites can change anything"),
];

/// Kills or stops the process if the environment names this failpoint.
#[cfg(not(feature = "failpoints"))]
#[inline]
pub(crate) fn failpoint(_name: &str) {}

/// Kills or stops the process if the environment names this failpoint.
#[cfg(feature = "failpoints")]
pub(crate) fn failpoint(name: &str) {
    use std::sync::atomic::{AtomicU32, Ordering};
    static PASSES: AtomicU32 = AtomicU32::new(0);
    debug_assert!(FAILPOINTS.contains(&name), "{name} is listed");
    if std::env::var("WANDLESS_STANDSTILL").is_ok_and(|point| point == name) {
        let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::STOP);
        std::thread::sleep(std::time::Duration::from_millis(50)); // the signal needs a moment to stop every thread
    }
    let Ok(requested) = std::env::var("WANDLESS_FAILPOINT") else { return };
    let (point, pass) = requested.split_once(':').unwrap_or((&requested, "1"));
    if point == name && PASSES.fetch_add(1, Ordering::SeqCst) + 1 == pass.parse().unwrap_or(1) {
        eprintln!("failpoint {name}");
        let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    }
}

/// Delays the start of a stage by `WANDLESS_LINGER_MS`, so that a check can kill the process during short stages.
pub(crate) fn linger() {
    #[cfg(feature = "failpoints")]
    if let Some(milliseconds) = std::env::var("WANDLESS_LINGER_MS").ok().and_then(|text| text.parse().ok()) {
        std::thread::sleep(std::time::Duration::from_millis(milliseconds));
    }
}

/// Duration and result folder of `WANDLESS_SIMULATED_JOB`, with which checks measure the service without the solver.
pub(crate) fn simulated_job() -> Option<(std::time::Duration, std::path::PathBuf)> {
    #[cfg(feature = "failpoints")]
    if let Ok(text) = std::env::var("WANDLESS_SIMULATED_JOB") {
        let (milliseconds, folder) = text.split_once(':')?;
        return Some((std::time::Duration::from_millis(milliseconds.parse().ok()?), folder.into()));
    }
    None
}

/// `WANDLESS_SWEEP_S`, the time between two sweeps of the object store, in place of `usual`.
#[cfg(feature = "scale")]
pub(crate) fn sweep_interval(usual: std::time::Duration) -> std::time::Duration {
    #[cfg(feature = "failpoints")]
    if let Some(seconds) = std::env::var("WANDLESS_SWEEP_S").ok().and_then(|text| text.parse().ok()) {
        return std::time::Duration::from_secs(seconds);
    }
    usual
}

/// An option that only the release after this one has; see [`is_next_release`].
pub(crate) const OPTION_OF_NEXT_RELEASE: &str = "of_the_next_release";

/// Whether this program takes the part of the release after itself, in a check of upgrades.
pub(crate) fn is_next_release() -> bool {
    cfg!(feature = "failpoints") && std::env::var_os("WANDLESS_NEXT_RELEASE").is_some()
}

/// An error after one in `WANDLESS_LOST_ANSWERS` commits, as if its answer were lost. Which ones follows from their number in
/// no regular order: repetitions would otherwise let the same step meet every loss.
///
/// # Errors
/// See above; never without the feature `failpoints`.
pub(crate) fn lose_answer() -> std::io::Result<()> {
    #[cfg(feature = "failpoints")]
    {
        use std::sync::atomic::{AtomicU64, Ordering};
        static COMMITS: AtomicU64 = AtomicU64::new(0);
        const MIX: u64 = 0x9e37_79b9_7f4a_7c15; // 2^64 divided by the golden ratio: spreads consecutive numbers
        let one_in = std::env::var("WANDLESS_LOST_ANSWERS").ok().and_then(|text| text.parse::<u64>().ok());
        let mixed = COMMITS.fetch_add(1, Ordering::SeqCst).wrapping_mul(MIX);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(MIX) >> 32;
        if one_in.is_some_and(|n| n > 0 && mixed % n == 0) {
            return Err(std::io::Error::other("the answer to the COMMIT was lost"));
        }
    }
    Ok(())
}

/// Whether the environment names this fault.
#[cfg(not(feature = "failpoints"))]
#[inline]
pub(crate) const fn fault(_name: &str) -> bool {
    false
}

/// Whether the environment names this fault.
#[cfg(feature = "failpoints")]
pub(crate) fn fault(name: &str) -> bool {
    debug_assert!(FAULTS.iter().any(|(known, _)| *known == name), "{name} is listed");
    std::env::var("WANDLESS_FAULT").is_ok_and(|requested| requested == name)
}
