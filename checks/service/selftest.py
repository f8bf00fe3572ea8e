"""Runs each check against the fault that it must detect; a check that passes on a broken guarantee is ineffective.

    cargo build --release --features failpoints,scale --target-dir target/failpoints
    python3 checks/service/selftest.py --program target/failpoints/release/wandless

The faults are listed in `src/service/failpoint.rs`; each needs an entry here.
"""

import os
import re
import subprocess
import sys
import time

from harness import arguments

HERE = os.path.dirname(os.path.abspath(__file__))

# Fault: text that the check must report (a regular expression); the check and its arguments, as few repetitions as suffice to detect the fault.
FAULTS = {
    "enqueue.early": ("is lost", "crashes.py", "--kills", "20"),
    "publish.late": ("no whole result", "crashes.py", "--kills", "0", "--only", "finish.committed"),
    "recovery.blames": ("counted against", "crashes.py", "--kills", "12"),
    "recovery.forgets": ("still running", "crashes.py", "--kills", "12"),
    "checkpoint.ignored": ("A7", "safety.py", "--only", "resume", "--kills", "1"),
    "crashes.uncounted": ("A9", "stops.py", "--only", "poison"),
    "silence.tolerated": ("A11", "stops.py", "--only", "paused"),
    "cancel.deaf": ("a cancel", "stops.py", "--only", "cancels", "--cancels", "4"),
    "stop.endless": ("a stop", "stops.py", "--only", "stops", "--stops", "1"),
    "lock.none": ("A12", "stops.py", "--only", "paused"),
    "busy.impatient": ("B2", "stops.py", "--only", "held"),
    "disk.unnamed": ("B1", "stops.py", "--only", "full_disk", "--disks", "4"),
    "claim.clocked": ("B4", "stops.py", "--only", "clocks"),
    "body.patient": ("C1", "sockets.py", "--only", "slow_clients", "--slow", "20", "--seconds", "70"),
    "key.ignored": ("C4", "sockets.py", "--only", "one_key"),
    "range.shifted": ("C6", "sockets.py", "--only", "ranges"),
    "leavers.kept": ("C7", "sockets.py", "--only", "disconnects"),
    "guesses.free": ("E6", "sockets.py", "--only", "guesses"),
    "length.unread": ("C5", "sockets.py", "--only", "malformed_http"),
    "claims.scanned": ("plan", "load.py", "--jobs", "300", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "answers.slow": ("status p99", "load.py", "--jobs", "300", "--clients", "20", "--seconds", "4", "--solver-frames", "300"),
    "start.slow": ("start", "load.py", "--jobs", "100", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "limits.none": ("spaces", "hostile.py", "--flips", "500"),
    "tenants.one": ("E1", "tenants.py", "--calls", "40"),
    "keys.kept": ("revoked", "tenants.py", "--calls", "40"),
    "webhooks.anywhere": ("E7", "tenants.py", "--calls", "40"),
    "quota.none": ("E9", "tenants.py", "--calls", "40"),
    "disk.unwatched": ("row 1", "storage.py", "--row", "1"),
    "pages.unbounded": ("row 4", "storage.py", "--row", "4"),
    "arrivals.uncounted": ("row 8", "storage.py", "--row", "8"),
    "verify.blind": ("F3", "safety.py", "--only", "flips", "--flips", "2"),
    "backup.short": ("F1", "safety.py", "--only", "backups", "--backups", "2"),
    "damage.silent": ("A14", "safety.py", "--only", "damaged_folders"),
    "commit.forgotten": ("no whole result", "crashes.py", "--kills", "0", "--lost", "10"),
    "seed.random": ("F5", "safety.py", "--only", "same_bytes"),
    "uploads.unlimited": ("row 5", "workers.py", "--row", "5"),
    "uploads.spilled": ("D3", "hostile.py", "--flips", "500"),
    "webhooks.unfair": ("row 9", "workers.py", "--row", "9"),
    "children.free": ("row 19", "workers.py", "--row", "19"),
    "fence.none": ("stale", "scale.py", "--row", "frozen_at_the_end", "--freezes", "3"),
    "beat.none": ("fell silent", "scale.py", "--row", "frozen_at_the_end", "--freezes", "3"),
    "sweep.eager": ("states|corrupt", "scale.py", "--row", "kills", "--kills", "1"),
    "row.unlocked": ("ran at once", "scale.py", "--row", "turns_of_tenants", "--jobs", "300"),
    "drain.abrupt": ("requests failed", "scale.py", "--row", "two_releases"),
    "descriptors.unreserved": ("row 2", "front.py", "--row", "2"),
    "idlers.kept": ("row 3", "front.py", "--row", "3"),
    "hosts.any": ("row 6", "front.py", "--row", "6"),
    "origins.any": ("row 7", "front.py", "--row", "7"),
}


def main():
    args = arguments(__doc__, only="", limit=300)
    with open(os.path.join(HERE, "..", "..", "src", "service", "failpoint.rs")) as source:
        table = source.read().split("FAULTS", 1)[1].split("];", 1)[0]
    known = set(re.findall(r'\("([a-z.]+)",', table))
    missed = sorted(known ^ set(FAULTS))
    if missed:
        print("faults without a check, or checks without a fault:", missed)
    for fault, (mark, check, *words) in FAULTS.items():
        if args.only not in fault:
            continue
        start = time.monotonic()
        command = [sys.executable, os.path.join(HERE, check), "--program", args.program, "--seed", str(args.seed), *words]
        try:
            run = subprocess.run(command, env={**os.environ, "WANDLESS_FAULT": fault}, capture_output=True, text=True, timeout=args.limit)
            found = [line for line in run.stdout.splitlines() if line.startswith("FAULT") or ": FAILED: " in line or ": FAULT " in line]
            matching = [line for line in found if re.search(mark, line)]
            detected = run.returncode == 1 and bool(matching)
            how = (matching or found or run.stderr.strip().splitlines()[-1:] or ["no output"])[0][:110]
        except subprocess.TimeoutExpired:
            detected, how = False, "timeout"
        print(f"{'detected' if detected else 'MISSED  '} {fault:<20} {check:<12} {time.monotonic() - start:4.0f} s  {how}", flush=True)
        if not detected:
            missed.append(fault)
    print("FAILED" if missed else "passed", missed or "")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
