//! File descriptors: how many connections leave enough of them for the work.
//!
//! Connections, the database and running jobs share one limit of the operating system. Connections must not use it up: a
//! job whose files cannot be opened fails.

use crate::service::failpoint::fault;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// A connection and the file that it uploads or downloads.
const PER_CONNECTION: u64 = 2;
/// Pipes of a job's process, its session, its result, its checkpoints, with as many again while it starts or ends.
const PER_JOB: u64 = 16;
/// Database (7 connections with 3 files each), webhooks (16 calls), validations, exports, backups, the runtime: about 80,
/// and as many again to be sure.
const RESERVE: u64 = 160;

/// Raises the soft limit of descriptors as far as `wanted` connections and `n_jobs` concurrent jobs need it. Returns the
/// number of connections, at most `wanted`, that the limit allows.
pub(super) fn allowed_connections(wanted: usize, n_jobs: usize) -> usize {
    if fault("descriptors.unreserved") {
        return wanted;
    }
    let reserve = RESERVE + PER_JOB * n_jobs as u64;
    let available = raise_limit(reserve.saturating_add(PER_CONNECTION.saturating_mul(wanted as u64)));
    let allowed = fitting(wanted, reserve, available);
    if allowed < wanted {
        tracing::warn!(
            allowed,
            wanted,
            descriptors = available,
            "fewer connections than limits.max_connections: raise the hard limit of file descriptors (ulimit -Hn, LimitNOFILE)"
        );
    }
    allowed
}

/// Connections that `available` descriptors allow beside the reserve, which takes at most half of them.
fn fitting(wanted: usize, reserve: u64, available: u64) -> usize {
    let rest = available - reserve.min(available / 2);
    usize::try_from(rest / PER_CONNECTION).unwrap_or(usize::MAX).clamp(1, wanted)
}

/// Raises the soft limit to `needed`, or to the hard limit where that is lower; returns the limit that holds then.
fn raise_limit(needed: u64) -> u64 {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let Some(current) = current else { return u64::MAX };
    let target = maximum.map_or(needed, |maximum| maximum.min(needed));
    if current >= target {
        return current;
    }
    match setrlimit(Resource::Nofile, Rlimit { current: Some(target), maximum }) {
        Ok(()) => target,
        Err(error) => {
            tracing::warn!(current, target, %error, "the limit of file descriptors cannot be raised");
            current
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_descriptors_for_the_work() {
        assert_eq!(fitting(1024, 176, 1 << 20), 1024);
        assert_eq!(fitting(1024, 176, 1024), 424);
        assert_eq!(fitting(1024, 176, 64), 16);
        assert_eq!(fitting(1024, 176, 0), 1);
    }
}
