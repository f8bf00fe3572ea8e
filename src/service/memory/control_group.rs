//! The memory control group of this process (Linux): its limit and those of the groups around it, versions 1 and 2.
//!
//! `/proc/self/cgroup` names the group, `/proc/self/mountinfo` the folder of its hierarchy. A limit binds all groups below
//! it, so that the smallest one on the way to the root counts.

use std::path::{Path, PathBuf};

/// Files of a memory control group, which differ between the versions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Files {
    limit: &'static str,
    /// Contains a line `oom_kill <count>`.
    events: &'static str,
}

const VERSION_1: Files = Files { limit: "memory.limit_in_bytes", events: "memory.oom_control" };
const VERSION_2: Files = Files { limit: "memory.max", events: "memory.events" };

/// The memory control group of this process and the groups around it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ControlGroup {
    /// Folders of the groups, innermost first.
    folders: Vec<PathBuf>,
    files: Files,
}

impl ControlGroup {
    /// Finds the group; `root` is `/` except in tests. `None` without control groups for memory.
    pub(super) fn of_this_process(root: &Path) -> Option<Self> {
        let read = |name: &str| std::fs::read_to_string(root.join(name)).ok();
        let (groups, mounts) = (read("proc/self/cgroup")?, read("proc/self/mountinfo")?);
        let groups: Vec<GroupLine> = groups.lines().filter_map(GroupLine::parse).collect();
        let mounts: Vec<Mount> = mounts.lines().filter_map(Mount::parse).collect();
        // Where both versions are mounted, the controller belongs to one of them: version 1 if it names `memory`.
        [VERSION_1, VERSION_2].into_iter().find_map(|files| {
            let group = groups.iter().find(|group| group.files == files)?;
            let mount = mounts.iter().find(|mount| mount.files == files)?;
            let folders = mount.folders(group.path, root);
            folders.iter().any(|folder| folder.join(files.limit).exists()).then_some(Self { folders, files })
        })
    }

    /// Smallest limit of the groups, bytes; `None` if none has a limit.
    pub(super) fn limit(&self) -> Option<u64> {
        self.folders.iter().filter_map(|folder| read(folder, self.files.limit)?.trim().parse().ok()).min()
    }

    /// How many processes of the group the kernel has ended because memory ran out.
    pub(super) fn kills(&self) -> Option<u64> {
        let text = self.folders.iter().find_map(|folder| read(folder, self.files.events))?;
        text.lines().find_map(|line| line.strip_prefix("oom_kill ")?.trim().parse().ok())
    }
}

fn read(folder: &Path, file: &str) -> Option<String> {
    std::fs::read_to_string(folder.join(file)).ok()
}

/// A line of `/proc/self/cgroup` that concerns memory: `4:memory:/a/b`, or `0::/a/b` of version 2.
#[derive(Debug)]
struct GroupLine<'a> {
    files: Files,
    path: &'a str,
}

impl<'a> GroupLine<'a> {
    fn parse(line: &'a str) -> Option<Self> {
        let mut parts = line.splitn(3, ':');
        let (id, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
        if controllers.split(',').any(|controller| controller == "memory") {
            return Some(Self { files: VERSION_1, path });
        }
        (id == "0" && controllers.is_empty()).then_some(Self { files: VERSION_2, path })
    }
}

/// A line of `/proc/self/mountinfo` that mounts a hierarchy with memory groups.
#[derive(Debug)]
struct Mount<'a> {
    files: Files,
    /// Group that is mounted: `/`, or the group of a container.
    group: &'a str,
    /// Where it is mounted.
    folder: &'a str,
}

impl<'a> Mount<'a> {
    fn parse(line: &'a str) -> Option<Self> {
        let (mount, system) = line.split_once(" - ")?;
        let mut mount = mount.split(' ').skip(3);
        let (group, folder) = (mount.next()?, mount.next()?);
        let mut system = system.split(' ');
        let (kind, options) = (system.next()?, system.nth(1)?);
        let files = match kind {
            "cgroup2" => VERSION_2,
            "cgroup" if options.split(',').any(|option| option == "memory") => VERSION_1,
            _ => return None,
        };
        Some(Self { files, group, folder })
    }

    /// Folders of the group `path` and of the groups around it, innermost first. A group that is not below the mounted one
    /// (in some containers) counts as the mounted one.
    fn folders(&self, path: &str, root: &Path) -> Vec<PathBuf> {
        let top = root.join(self.folder.trim_start_matches('/'));
        let below = Path::new(path).strip_prefix(self.group).ok();
        let below = below.filter(|below| !below.components().any(|part| part.as_os_str() == ".."));
        let innermost = top.join(below.unwrap_or(Path::new("")));
        innermost.ancestors().take_while(|folder| folder.starts_with(&top)).map(Path::to_owned).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A system's files below a temporary folder.
    fn system(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let path = root.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        root
    }

    fn limit_and_kills(files: &[(&str, &str)]) -> (Option<u64>, Option<u64>) {
        let root = system(files);
        let group = ControlGroup::of_this_process(root.path());
        group.map_or((None, None), |group| (group.limit(), group.kills()))
    }

    const MOUNT_2: (&str, &str) =
        ("proc/self/mountinfo", "30 23 0:26 / /sys/fs/cgroup rw,nosuid - cgroup2 cgroup2 rw,nsdelegate\n");

    #[test]
    fn smallest_limit_on_the_way_to_the_root_counts() {
        let files = [
            MOUNT_2,
            ("proc/self/cgroup", "0::/system.slice/wandless.service/jobs\n"),
            ("sys/fs/cgroup/system.slice/memory.max", "2147483648\n"),
            ("sys/fs/cgroup/system.slice/wandless.service/memory.max", "1073741824\n"),
            ("sys/fs/cgroup/system.slice/wandless.service/jobs/memory.max", "max\n"),
            ("sys/fs/cgroup/system.slice/wandless.service/jobs/memory.events", "low 0\noom 3\noom_kill 2\n"),
        ];
        assert_eq!(limit_and_kills(&files), (Some(1 << 30), Some(2)));
    }

    #[test]
    fn reads_version_1_beside_an_empty_version_2() {
        let mounts = "35 31 0:32 / /sys/fs/cgroup/memory rw,relatime - cgroup cgroup rw,memory\n\
                      41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw\n";
        let files = [
            ("proc/self/mountinfo", mounts),
            ("proc/self/cgroup", "4:memory:/a/b\n1:cpu,cpuacct:/\n0::/\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/a/memory.limit_in_bytes", "536870912\n"),
            ("sys/fs/cgroup/memory/a/b/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/a/b/memory.oom_control", "oom_kill_disable 0\nunder_oom 0\noom_kill 1\n"),
        ];
        assert_eq!(limit_and_kills(&files), (Some(512 << 20), Some(1)));
    }

    #[test]
    fn container_sees_its_own_group_as_the_root() {
        for (mounted, group) in [("/docker/7f", "/docker/7f"), ("/", "/"), ("/docker/7f", "/"), ("/", "/../other")] {
            let mount = format!("30 23 0:26 {mounted} /sys/fs/cgroup ro - cgroup2 cgroup rw\n");
            let files = [
                ("proc/self/mountinfo", mount.as_str()),
                ("proc/self/cgroup", &format!("0::{group}\n")),
                ("sys/fs/cgroup/memory.max", "1073741824\n"),
            ];
            assert_eq!(limit_and_kills(&files).0, Some(1 << 30), "{mounted} {group}");
        }
    }

    #[test]
    fn without_control_groups_nothing_is_limited() {
        assert_eq!(limit_and_kills(&[]), (None, None));
        assert_eq!(limit_and_kills(&[MOUNT_2, ("proc/self/cgroup", "0::/a\n")]), (None, None));
    }
}
