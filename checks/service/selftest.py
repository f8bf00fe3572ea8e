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

# Fault, check, its words: as little of the check as should notice.
FAULTS = {
    "enqueue.early": ("crashes.py", "--kills", "20"),
    "publish.late": ("crashes.py", "--kills", "0", "--only", "finish.committed"),
    "recovery.blames": ("crashes.py", "--kills", "12"),
    "recovery.forgets": ("crashes.py", "--kills", "12"),
    "checkpoint.ignored": ("safety.py", "--only", "resume", "--kills", "1"),
    "deaths.uncounted": ("stops.py", "--only", "poison"),
    "silence.tolerated": ("stops.py", "--only", "paused"),
    "cancel.deaf": ("stops.py", "--only", "cancels", "--cancels", "4"),
    "stop.endless": ("stops.py", "--only", "stops", "--stops", "1"),
    "lock.none": ("stops.py", "--only", "paused"),
    "busy.impatient": ("stops.py", "--only", "held"),
    "disk.unnamed": ("stops.py", "--only", "full_disk", "--disks", "4"),
    "claim.clocked": ("stops.py", "--only", "clocks"),
    "body.patient": ("sockets.py", "--only", "slow_clients", "--slow", "20", "--seconds", "70"),
    "key.ignored": ("sockets.py", "--only", "one_key"),
    "range.shifted": ("sockets.py", "--only", "ranges"),
    "leavers.kept": ("sockets.py", "--only", "leavers"),
    "guesses.free": ("sockets.py", "--only", "guesses"),
    "length.unread": ("sockets.py", "--only", "abuse"),
    "claims.scanned": ("load.py", "--jobs", "300", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "answers.slow": ("load.py", "--jobs", "300", "--clients", "20", "--seconds", "4", "--solver-frames", "300"),
    "start.slow": ("load.py", "--jobs", "100", "--clients", "20", "--seconds", "2", "--solver-frames", "300"),
    "limits.none": ("hostile.py", "--flips", "500"),
    "tenants.one": ("tenants.py", "--calls", "40"),
    "keys.kept": ("tenants.py", "--calls", "40"),
    "webhooks.anywhere": ("tenants.py", "--calls", "40"),
    "quota.none": ("tenants.py", "--calls", "40"),
    "verify.blind": ("safety.py", "--only", "flips", "--flips", "2"),
    "backup.short": ("safety.py", "--only", "backups", "--backups", "2"),
    "damage.silent": ("safety.py", "--only", "damaged_folders"),
    "seed.random": ("safety.py", "--only", "same_bytes"),
}


def main():
    asked = arguments(__doc__, only="", limit=300)
    with open(os.path.join(HERE, "..", "..", "src", "service", "failpoint.rs")) as source:
        table = source.read().split("FAULTS", 1)[1].split("];", 1)[0]
    known = set(re.findall(r'\("([a-z.]+)",', table))
    blind = sorted(known ^ set(FAULTS))
    if blind:
        print("faults without a check, or checks without a fault:", blind)
    for fault, (check, *words) in FAULTS.items():
        if asked.only not in fault:
            continue
        start = time.monotonic()
        command = [sys.executable, os.path.join(HERE, check), "--program", asked.program, "--seed", str(asked.seed), *words]
        try:
            run = subprocess.run(command, env={**os.environ, "WANDLESS_FAULT": fault}, capture_output=True, text=True, timeout=asked.limit)
            found = [line for line in run.stdout.splitlines() if line.startswith("FAULT")]
            how = found[0][:110] if found else run.stderr.strip().rsplit("\n", 1)[-1][:110]
            noticed = run.returncode == 1 and bool(found or run.stderr)
        except subprocess.TimeoutExpired:
            noticed, how = True, "it never ended"
        print(f"{'noticed' if noticed else 'BLIND  '} {fault:<20} {check:<12} {time.monotonic() - start:4.0f} s  {how}", flush=True)
        if not noticed:
            blind.append(fault)
    print("FAILED" if blind else "passed", blind or "")
    sys.exit(1 if blind else 0)


if __name__ == "__main__":
    main()
