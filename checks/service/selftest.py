"""Every check against the fault it is there to find: a run that does not fail on a broken promise is blind.

    cargo build --release --features failpoints --target-dir target/failpoints
    python3 checks/service/selftest.py --program target/failpoints/release/wandless

The faults are those of `src/service/failpoint.rs`; each must have its line here.
"""

import os
import re
import subprocess
import sys
import time

from harness import arguments

HERE = os.path.dirname(os.path.abspath(__file__))

# Fault; what the check must say of it; the check and its words, as little of it as should notice.
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
    "leavers.kept": ("C7", "sockets.py", "--only", "leavers"),
    "guesses.free": ("E6", "sockets.py", "--only", "guesses"),
    "length.unread": ("C5", "sockets.py", "--only", "abuse"),
    "claims.scanned": ("plan", "load.py", "--jobs", "300", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "answers.slow": ("status p99", "load.py", "--jobs", "300", "--clients", "20", "--seconds", "4", "--solver-frames", "300"),
    "start.slow": ("start", "load.py", "--jobs", "100", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "limits.none": ("spaces", "hostile.py", "--flips", "500"),
    "tenants.one": ("E1", "tenants.py", "--calls", "40"),
    "keys.kept": ("revoked", "tenants.py", "--calls", "40"),
    "webhooks.anywhere": ("E7", "tenants.py", "--calls", "40"),
    "quota.none": ("E9", "tenants.py", "--calls", "40"),
    "verify.blind": ("F3", "safety.py", "--only", "flips", "--flips", "2"),
    "backup.short": ("F1", "safety.py", "--only", "backups", "--backups", "2"),
    "damage.silent": ("A14", "safety.py", "--only", "damaged_folders"),
    "seed.random": ("F5", "safety.py", "--only", "same_bytes"),
}


def main():
    asked = arguments(__doc__, only="", limit=300)
    with open(os.path.join(HERE, "..", "..", "src", "service", "failpoint.rs")) as source:
        table = source.read().split("FAULTS", 1)[1].split("];", 1)[0]
    known = set(re.findall(r'\("([a-z.]+)",', table))
    blind = sorted(known ^ set(FAULTS))
    if blind:
        print("faults without a check, or checks without a fault:", blind)
    for fault, (mark, check, *words) in FAULTS.items():
        if asked.only not in fault:
            continue
        start = time.monotonic()
        command = [sys.executable, os.path.join(HERE, check), "--program", asked.program, "--seed", str(asked.seed), *words]
        try:
            run = subprocess.run(command, env={**os.environ, "WANDLESS_FAULT": fault}, capture_output=True, text=True, timeout=asked.limit)
            found = [line for line in run.stdout.splitlines() if line.startswith("FAULT")]
            told = [line for line in found if mark in line]
            noticed = run.returncode == 1 and bool(told)
            how = (told or found or run.stderr.strip().splitlines()[-1:] or ["nothing was said"])[0][:110]
        except subprocess.TimeoutExpired:
            noticed, how = False, "it did not end in time"
        print(f"{'noticed' if noticed else 'BLIND  '} {fault:<20} {check:<12} {time.monotonic() - start:4.0f} s  {how}", flush=True)
        if not noticed:
            blind.append(fault)
    print("FAILED" if blind else "passed", blind or "")
    sys.exit(1 if blind else 0)


if __name__ == "__main__":
    main()
