"""The queue at depth: a hundred thousand waiting jobs of 16 and of 10,000 tenants, beside as many tenants without jobs.

    python3 checks/service/depth.py --jobs 100000 --seconds 20

Eight workers claim jobs and end them at once (their options are unreadable), while one client submits, lists and reads the
figures. Bounds: 200 claims a second, at most 100 ms between one claim and the next for 99 of 100 claims, and 50 ms for 99 of
100 acceptances, lists and readings.
"""

import http.client
import json
import os
import sqlite3
import subprocess
import time
import uuid

from harness import Faults, Service, arguments, percentile, take

N_WORKERS = 8


def main():
    args = arguments(__doc__, jobs=100_000, seconds=20, idle=10_000)
    faults = Faults()
    for n_tenants in (16, 10_000):
        words = ["--set", f"jobs.concurrent={N_WORKERS}", "--set", f"limits.max_queued={10 * args.jobs}",
                 "--set", f"tenants.max_queued={10 * args.jobs}", "--set", "tenants.requests_per_s=100000"]
        service = Service(args.program, words=words)
        service.start()
        session = service.client().upload(take(10, 2))["id"]
        service.stop()
        fill(service, session, args.jobs, n_tenants, args.idle)
        key = create_key(service)
        started = service.start()
        print(f"{args.jobs} jobs of {n_tenants} tenants: start {1000 * started:.0f} ms", flush=True)
        measure(service, session, key, args, faults)
        service.kill()
        claims(service, args, faults)
        service.remove()
    faults.end()


def fill(service, session, n_jobs, n_tenants, n_idle):
    """Adds jobs that end as soon as they are claimed, and tenants without jobs."""
    with sqlite3.connect(os.path.join(service.data, "wandless.db")) as database:
        database.execute("PRAGMA synchronous = OFF")
        names = [f"idle{n}" for n in range(n_idle)] + [f"tenant{n}" for n in range(n_tenants)]
        database.executemany("INSERT INTO tenants (name) VALUES (?)", ((name,) for name in names))
        database.executemany(
            """INSERT INTO jobs (id, tenant, session_id, options, labels, priority, state, created_at)
               VALUES (?, ?, ?, '{"unreadable": true}', '{}', 0, 'queued', '2026-01-01T00:00:00.000Z')""",
            ((f"job_{uuid.uuid4().hex}", f"tenant{n % n_tenants}", session) for n in range(n_jobs)))


def create_key(service):
    """A key of the tenant that owns the session, with all scopes."""
    command = [service.program, "key", "create", "--data", service.data, "--scopes", "read,write,metrics"]
    created = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return next(word for word in created.split() if word.startswith("wl_"))


def measure(service, session, key, args, faults):
    """Response times while the workers claim."""
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
    body = json.dumps({"session": session, "options": {"extrinsics": "fixed", "exports": []}, "priority": -1000})
    requests = {"accept": ("POST", "/v1/jobs", body, 202), "list": ("GET", "/v1/jobs?page_size=50", None, 200),
                "figures": ("GET", "/metrics", None, 200)}
    times = {name: [] for name in requests}
    end = time.monotonic() + args.seconds
    while time.monotonic() < end:
        for name, (method, path, body, expected) in requests.items():
            start = time.monotonic()
            headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/json"}
            connection.request(method, path, body=body, headers=headers)
            answer = connection.getresponse()
            answer.read()
            times[name].append(time.monotonic() - start)
            faults.require(answer.status == expected, f"{name} was answered {answer.status}")
        time.sleep(0.02)
    for name, seconds in times.items():
        worst = percentile(seconds, 0.99)
        print(f"  {name}: p50 {1000 * percentile(seconds, 0.5):.1f} ms, p99 {1000 * worst:.1f} ms of {len(seconds)}", flush=True)
        faults.require(worst <= 0.05, f"{name}: p99 is above 50 ms")


def claims(service, args, faults):
    """Rate of claims, and time between one claim and the next."""
    with sqlite3.connect(os.path.join(service.data, "wandless.db")) as database:
        rows = database.execute("""SELECT 86400.0 * (julianday(started_at) - 2440587.5) FROM jobs
                                   WHERE started_at IS NOT NULL AND state = 'failed' ORDER BY 1""")
        moments = [moment for (moment,) in rows]
        kept, = database.execute("SELECT sum(n_queued + n_running + n_failed) FROM tenants").fetchone()
        counted, = database.execute("SELECT count(*) FROM jobs WHERE state IN ('queued', 'running', 'failed')").fetchone()
    gaps = [after - before for before, after in zip(moments, moments[1:])]
    rate = len(gaps) / (moments[-1] - moments[0])
    worst = percentile(gaps, 0.99)
    print(f"  {len(moments)} claims, each ended: {rate:.0f} a second; next claim p50 {1000 * percentile(gaps, 0.5):.1f} ms, "
          f"p99 {1000 * worst:.1f} ms", flush=True)
    faults.require(rate >= 200, "fewer than 200 claims a second")
    faults.require(worst <= 0.1, "the p99 between two claims is above 100 ms")
    faults.require(kept == counted, f"the counters say {kept} jobs, the table has {counted}")


if __name__ == "__main__":
    main()
