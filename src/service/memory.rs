//! Memory limit of one job.

use super::settings::JobSettings;

/// Share of the machine's memory for all jobs together; the rest is for the service, the file cache and the system.
const JOBS_SHARE: f64 = 0.75;

/// Returns the address space limit of one child process, bytes; `None` if it is not set and the memory size is unknown.
pub(super) fn child_limit(settings: &JobSettings) -> Option<u64> {
    if settings.memory_bytes > 0 {
        return Some(settings.memory_bytes);
    }
    let machine = [machine_bytes(), control_group_bytes()].into_iter().flatten().min()?;
    Some((machine as f64 * JOBS_SHARE / settings.concurrent as f64) as u64)
}

/// Reads the machine's memory size: `MemTotal` of Linux.
fn machine_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// Reads the memory limit of the process's control group, which containers have.
fn control_group_bytes() -> Option<u64> {
    let files = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    files.iter().find_map(|file| std::fs::read_to_string(file).ok()?.trim().parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uses_the_setting_or_shares_the_machine() {
        let set = JobSettings { memory_bytes: 7, ..JobSettings::default() };
        assert_eq!(child_limit(&set), Some(7));
        let one = child_limit(&JobSettings::default());
        let two = child_limit(&JobSettings { concurrent: 2, ..JobSettings::default() });
        assert_eq!(one.map(|bytes| bytes / 2), two);
    }
}
