//! Memory limits of the child processes.
//!
//! The jobs together get three quarters of the machine or of the control group, the validations and inspections of uploads a quarter. When
//! memory runs out nevertheless, the kernel ends a validation first, then a job, and the service last (see `oom_score`).

mod control_group;

use super::settings::{JobSettings, RequestLimits};
use control_group::ControlGroup;
use std::path::Path;

/// Share of the machine's memory for all jobs together; the rest is for the service, uploads, the file cache and the system.
const JOBS_SHARE: f64 = 0.75;

/// Share of the machine's memory for one validation of an upload; two run at the same time.
const UPLOAD_SHARE: f64 = 0.125;

/// Lowest limit of a validation that is not set, bytes: enough for five minutes of 4 cameras and 4 people. In a group of
/// 1 GiB two of them and a job can exceed the memory together; then a validation is ended.
const MIN_UPLOAD_BYTES: u64 = 256 << 20;

/// Returns the address space limit of the child process of a job, bytes; `None` if it is not set and the memory size is
/// unknown.
pub(super) fn job_limit(settings: &JobSettings) -> Option<u64> {
    if settings.memory_bytes > 0 {
        return Some(settings.memory_bytes);
    }
    Some((available_bytes()? as f64 * JOBS_SHARE / settings.concurrent as f64) as u64)
}

/// Returns the address space limit of the child process that validates an upload, bytes; `None` as for jobs.
pub(super) fn upload_limit(limits: &RequestLimits) -> Option<u64> {
    if limits.validation_memory_bytes > 0 {
        return Some(limits.validation_memory_bytes);
    }
    Some(((available_bytes()? as f64 * UPLOAD_SHARE) as u64).max(MIN_UPLOAD_BYTES))
}

/// Memory that all processes of the service can use together, bytes.
fn available_bytes() -> Option<u64> {
    [machine_bytes(), group_limit()].into_iter().flatten().min()
}

/// Returns the smallest memory limit of the process's control group and the groups around it, bytes.
pub(super) fn group_limit() -> Option<u64> {
    ControlGroup::of_this_process(Path::new("/"))?.limit()
}

/// Returns how many processes of the control group the kernel has ended because memory ran out.
pub(super) fn group_kills() -> Option<u64> {
    ControlGroup::of_this_process(Path::new("/"))?.kills()
}

/// Reads the machine's memory size: `MemTotal` of Linux.
fn machine_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uses_the_setting_or_shares_the_machine() {
        let set = JobSettings { memory_bytes: 7, ..JobSettings::default() };
        assert_eq!(job_limit(&set), Some(7));
        let one = job_limit(&JobSettings::default());
        let two = job_limit(&JobSettings { concurrent: 2, ..JobSettings::default() });
        assert_eq!(one.map(|bytes| bytes / 2), two);
    }

    #[test]
    fn an_upload_gets_less_memory_than_a_job() {
        let set = RequestLimits { validation_memory_bytes: 7, ..RequestLimits::default() };
        assert_eq!(upload_limit(&set), Some(7));
        let shared = upload_limit(&RequestLimits::default());
        assert!(shared.is_none_or(|bytes| bytes >= MIN_UPLOAD_BYTES), "{shared:?}");
    }
}
