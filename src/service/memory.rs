//! How much memory one job may take.

use super::settings::JobSettings;

/// Share of the machine that all jobs together may address; the rest is the service's, the file cache's and the system's.
const JOBS_SHARE: f64 = 0.75;

/// Address space of one child, bytes; `None` where nothing is set and the machine does not tell its size.
pub(super) fn child_limit(settings: &JobSettings) -> Option<u64> {
    if settings.memory_bytes > 0 {
        return Some(settings.memory_bytes);
    }
    let machine = [machine_bytes(), group_bytes()].into_iter().flatten().min()?;
    Some((machine as f64 * JOBS_SHARE / settings.concurrent as f64) as u64)
}

/// `MemTotal` of Linux.
fn machine_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

/// The limit of the own control group, where a container has one.
fn group_bytes() -> Option<u64> {
    let files = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    files.iter().find_map(|file| std::fs::read_to_string(file).ok()?.trim().parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_set_counts_and_the_machine_is_shared_otherwise() {
        let set = JobSettings { memory_bytes: 7, ..JobSettings::default() };
        assert_eq!(child_limit(&set), Some(7));
        let one = child_limit(&JobSettings::default());
        let two = child_limit(&JobSettings { concurrent: 2, ..JobSettings::default() });
        assert_eq!(one.map(|bytes| bytes / 2), two);
    }
}
