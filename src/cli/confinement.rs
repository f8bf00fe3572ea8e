//! Confinement of a child process: it reads and writes the files of its order and nothing else, opens no connection and
//! starts no program. Linux only; older kernels and other systems confine less or nothing.
//!
//! Two layers, because neither suffices: landlock knows paths, but covers only TCP; a filter of system calls knows no
//! paths, but covers every kind of socket. The upload that a child reads is the only input of the service that is parsed
//! with deep formats, so that a fault in a parser would have the rights of the child.

use std::path::Path;

/// Files that a child needs.
pub(super) struct Access<'a> {
    /// Files and folders that it reads.
    pub(super) reads: Vec<&'a Path>,
    /// Folders in which it reads and writes.
    pub(super) writes: Vec<&'a Path>,
}

/// Confines the calling thread and all threads that it starts from now on. On failure the work continues: its limits of
/// memory and time hold in any case.
#[cfg(target_os = "linux")]
pub(super) fn confine(access: &Access<'_>) {
    if crate::service::failpoint::fault("children.free") {
        return;
    }
    match linux::restrict_files(&access.reads, &access.writes) {
        Ok(status) => tracing::debug!(?status, "files are restricted by landlock"),
        Err(error) => tracing::warn!(%error, "landlock does not restrict this process"),
    }
    if let Err(error) = linux::restrict_calls() {
        tracing::warn!(%error, "the system calls of this process are not restricted");
    }
}

/// Other systems have no equivalent that an unprivileged process can use.
#[cfg(not(target_os = "linux"))]
pub(super) fn confine(_access: &Access<'_>) {}

#[cfg(target_os = "linux")]
mod linux {
    use landlock::{
        ABI, Access, AccessFs, AccessNet, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError, RulesetStatus, Scope,
        path_beneath_rules,
    };
    use seccompiler::{BpfProgram, SeccompAction, SeccompFilter};
    use std::collections::BTreeMap;
    use std::path::Path;

    /// Linux 6.12: files, TCP, signals. An older kernel enforces what it has.
    const LATEST: ABI = ABI::V6;

    /// Lets the thread open only files in `reads` and `writes`. Open files stay open.
    pub(super) fn restrict_files(reads: &[&Path], writes: &[&Path]) -> Result<RulesetStatus, RulesetError> {
        let read = AccessFs::ReadFile | AccessFs::ReadDir;
        let write = AccessFs::from_all(LATEST) & !AccessFs::Execute;
        let restricted = Ruleset::default()
            .handle_access(AccessFs::from_all(LATEST))?
            .handle_access(AccessNet::from_all(LATEST))?
            .scope(Scope::from_all(LATEST))?
            .create()?
            .add_rules(path_beneath_rules(reads, read))?
            .add_rules(path_beneath_rules(writes, write))?
            .restrict_self()?;
        Ok(restricted.ruleset)
    }

    /// System calls that fail with EPERM: they connect, start programs, or reach into other processes and the kernel. The
    /// solver needs none of them.
    const DENIED: [i64; 14] = [
        libc::SYS_socket,
        libc::SYS_io_uring_setup, // a second way to a socket
        libc::SYS_execve,
        libc::SYS_execveat,
        libc::SYS_ptrace,
        libc::SYS_process_vm_readv,
        libc::SYS_process_vm_writev,
        libc::SYS_pidfd_getfd,
        libc::SYS_unshare,
        libc::SYS_mount,
        libc::SYS_bpf,
        libc::SYS_keyctl,
        libc::SYS_perf_event_open,
        libc::SYS_userfaultfd,
    ];

    /// Mark of the x32 calls of x86-64 processors, and the numbers that differ there: execve, ptrace, process_vm_readv,
    /// process_vm_writev, execveat.
    const X32: i64 = 0x4000_0000;
    const X32_DENIED: [i64; 5] = [520, 521, 539, 540, 545];

    /// Denies the calls of [`DENIED`] to the thread.
    pub(super) fn restrict_calls() -> Result<(), seccompiler::Error> {
        let x32 = DENIED.iter().chain(&X32_DENIED).map(|call| call | X32);
        let x32 = x32.filter(|_| cfg!(target_arch = "x86_64"));
        let denied: BTreeMap<i64, Vec<_>> = DENIED.into_iter().chain(x32).map(|call| (call, Vec::new())).collect();
        let refusal = SeccompAction::Errno(libc::EPERM as u32);
        let filter = SeccompFilter::new(denied, SeccompAction::Allow, refusal, std::env::consts::ARCH.try_into()?)?;
        let program: BpfProgram = filter.try_into()?;
        seccompiler::apply_filter(&program)
    }
}

#[cfg(target_os = "linux")]
#[cfg(test)]
mod tests {
    use super::linux;
    use std::fs;
    use std::io::ErrorKind::PermissionDenied;
    use std::net::UdpSocket;

    /// Runs in a thread of its own, because a confinement lasts as long as its thread.
    #[test]
    fn a_child_reads_its_input_and_writes_its_folder_only() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        fs::write(path("input"), "in").unwrap();
        fs::write(path("other"), "other").unwrap();
        fs::create_dir(path("out")).unwrap();
        std::os::unix::fs::symlink(path("other"), path("out/link")).unwrap();
        let restricted = std::thread::scope(|scope| {
            let run = || {
                let (input, out) = (path("input"), path("out"));
                let restricted = linux::restrict_files(&[&input], &[&out]).unwrap();
                if restricted == landlock::RulesetStatus::NotEnforced {
                    return false;
                }
                assert_eq!(fs::read_to_string(&input).unwrap(), "in");
                assert_eq!(fs::write(&input, "x").unwrap_err().kind(), PermissionDenied);
                assert_eq!(fs::read(path("other")).unwrap_err().kind(), PermissionDenied);
                fs::create_dir_all(out.join("a/b")).unwrap();
                fs::write(out.join("a/b/c.tmp"), "c").unwrap();
                let _ = fs::rename(out.join("a/b/c.tmp"), out.join("c")); // the first version of landlock forbids it
                fs::write(out.join("d"), "d").unwrap();
                fs::write(out.join("d"), "").unwrap();
                fs::remove_file(out.join("d")).unwrap();
                assert_eq!(fs::write(out.join("link"), "x").unwrap_err().kind(), PermissionDenied);
                assert_eq!(fs::write(path("beside"), "x").unwrap_err().kind(), PermissionDenied);
                true
            };
            scope.spawn(run).join().unwrap()
        });
        if !restricted {
            eprintln!("SKIPPED: this kernel has no landlock");
        }
    }

    #[test]
    fn a_child_opens_no_connection_and_starts_no_program() {
        let run = || {
            linux::restrict_calls().unwrap();
            assert_eq!(UdpSocket::bind("127.0.0.1:0").unwrap_err().kind(), PermissionDenied);
            assert_eq!(std::process::Command::new("true").spawn().unwrap_err().kind(), PermissionDenied);
        };
        std::thread::spawn(run).join().unwrap();
        UdpSocket::bind("127.0.0.1:0").unwrap(); // other threads are free
    }
}
