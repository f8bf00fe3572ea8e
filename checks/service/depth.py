"""The queue at depth: very many waiting jobs of 16 and of 10,000 tenants, beside as many tenants without jobs.

    python3 checks/service/depth.py --jobs 100000 --seconds 20
    python3 checks/service/depth.py --jobs 1000000 --postgres 1      # a program with the feature `scale`

Eight workers claim jobs and end them at once (their options are unreadable), at first alone, then while one client submits, lists
and reads the figures. With SQLite what it submits has its turn, too, and is solved. Bounds: 200 claims a second, at most 100 ms between one claim
and the next for 99 of 100 claims, and 50 ms for 99 of 100 acceptances, lists and readings. With PostgreSQL one node answers the client
and two have the workers; what the client submits waits for a worker with more memory, since solves beside the API, which would be on
other machines, take the processors from it.
"""

import http.client
import json
import os
import sqlite3
import subprocess
import time

from cluster import Cluster
from harness import Faults, Service, arguments, percentile, take

N_WORKERS = 8

#: Frames of a session whose jobs no worker of the smallest class claims.
LONG_TAKE = 1_000_000

#: Jobs that end as soon as they are claimed, tenants that have them, and tenants without jobs. The texts of both databases differ in
#: how they count and in their ids.
JOBS = """INSERT INTO jobs (id, tenant, session_id, options, labels, priority, state, created_at)
          SELECT 'job_' || {id}, 'tenant' || n % {n_tenants}, '{session}', '{{"unreadable": true}}', '{{}}', 0, 'queued',
                 '2026-01-01T00:00:00.000Z' FROM {numbers}"""
TENANTS = "INSERT INTO tenants (name) SELECT '{prefix}' || n FROM {numbers}"


class Embedded:
    """The embedded default: one process on a folder with SQLite."""

    def __init__(self, args, words):
        words = [*words, "--set", f"jobs.concurrent={N_WORKERS}"]
        self.api = Service(args.program, words=words)
        self.api.start()
        self.session = self.api.client().upload(take(10, 2))["id"]
        self.api.stop()

    def fill(self, n_jobs, n_tenants, n_idle):
        def numbers(n):
            return f"(WITH RECURSIVE numbers (n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM numbers WHERE n + 1 < {n}) SELECT n FROM numbers)"
        with self.database() as database:
            database.execute("PRAGMA synchronous = OFF")
            for prefix, n in (("idle", n_idle), ("tenant", n_tenants)):
                database.execute(TENANTS.format(prefix=prefix, numbers=numbers(n)))
            database.execute(JOBS.format(id="lower(hex(randomblob(16)))", n_tenants=n_tenants, session=self.session, numbers=numbers(n_jobs)))

    def start(self):
        """The seconds that the start takes with so many jobs."""
        return self.api.start()

    def key(self):
        return create_key(self.api, ["--data", self.api.data])

    def end(self):
        self.api.kill()

    def ask(self, statement):
        with self.database() as database:
            return database.execute(statement).fetchall()

    def database(self):
        return sqlite3.connect(os.path.join(self.api.data, "wandless.db"))

    def remove(self):
        self.api.remove()


class Machines:
    """PostgreSQL, a node that answers clients, and two nodes with workers."""

    def __init__(self, args, words):
        self.cluster = Cluster(args.program)
        self.words = words
        self.api = self.cluster.node("api", *words)
        self.session = self.api.client().upload(take(10, 2))["id"]

    def fill(self, n_jobs, n_tenants, n_idle):
        """The counters are set at once: a million triggers on a few rows of one transaction would take hours."""
        for prefix, n in (("idle", n_idle), ("tenant", n_tenants)):
            self.ask(TENANTS.format(prefix=prefix, numbers=f"generate_series(0, {n - 1}) AS n"))
        jobs = JOBS.format(id="md5(random()::text || n)", n_tenants=n_tenants, session=self.session, numbers=f"generate_series(0, {n_jobs - 1}) AS n")
        self.ask(f"ALTER TABLE jobs DISABLE TRIGGER USER; {jobs}; ALTER TABLE jobs ENABLE TRIGGER USER;"
                 "UPDATE tenants SET n_queued = waiting.n, n_wanted_0 = waiting.n"
                 " FROM (SELECT tenant, count(*) AS n FROM jobs GROUP BY tenant) AS waiting WHERE name = waiting.tenant;"
                 "SELECT add_up_totals()")
        self.ask(f"UPDATE sessions SET n_frames = {LONG_TAKE}")
        self.ask("VACUUM ANALYZE jobs")
        self.ask("VACUUM ANALYZE tenants")

    def start(self):
        start = time.monotonic()
        for _ in range(2):
            self.cluster.node("worker", *self.words, "--set", f"jobs.concurrent={N_WORKERS // 2}", "--set", "worker.class=0")
        return time.monotonic() - start

    def key(self):
        return create_key(self.api, [])

    def end(self):
        for node in self.cluster.nodes:
            node.kill()

    def ask(self, statement):
        return self.cluster.postgres.ask(statement)

    def remove(self):
        self.cluster.remove()


def main():
    args = arguments(__doc__, jobs=100_000, seconds=20, idle=10_000, postgres=0)
    faults = Faults()
    words = ["--set", f"limits.max_queued={10 * args.jobs}", "--set", f"tenants.max_queued={10 * args.jobs}", "--set", "tenants.requests_per_s=100000"]
    for n_tenants in (16, 10_000):
        service = (Machines if args.postgres else Embedded)(args, words)
        try:
            service.fill(args.jobs, n_tenants, args.idle)
            key = service.key()
            started = service.start()
            print(f"{args.jobs} jobs of {n_tenants} tenants: start {1000 * started:.0f} ms", flush=True)
            time.sleep(args.seconds)
            claims(service, faults)
            measure(service, key, args, faults)
            service.end()
            counters(service, faults)
        finally:
            service.remove()
    faults.end()


def create_key(node, words):
    """A key of the tenant that owns the session, with all scopes."""
    command = [node.program, "key", "create", *words, "--scopes", "read,write,metrics"]
    created = subprocess.run(command, capture_output=True, text=True, check=True, env=node.environment).stdout
    return next(word for word in created.split() if word.startswith("wl_"))


def measure(service, key, args, faults):
    """Response times while the workers claim."""
    connection = http.client.HTTPConnection("127.0.0.1", service.api.port, timeout=60)
    body = json.dumps({"session": service.session, "options": {"extrinsics": "fixed", "exports": []}, "priority": -1000})
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


def claims(service, faults):
    """Rate of claims, and time between one claim and the next."""
    rows = service.ask("""SELECT 86400.0 * (julianday(started_at) - 2440587.5) FROM jobs
                          WHERE started_at IS NOT NULL AND state = 'failed' ORDER BY 1""")
    moments = [float(moment) for (moment,) in rows]
    gaps = [after - before for before, after in zip(moments, moments[1:])]
    rate = len(gaps) / (moments[-1] - moments[0])
    worst = percentile(gaps, 0.99)
    print(f"  {len(moments)} claims, each ended: {rate:.0f} a second; next claim p50 {1000 * percentile(gaps, 0.5):.1f} ms, "
          f"p99 {1000 * worst:.1f} ms", flush=True)
    faults.require(rate >= 200, "fewer than 200 claims a second")
    faults.require(worst <= 0.1, "the p99 between two claims is above 100 ms")


def counters(service, faults):
    (kept,), = service.ask("SELECT sum(n_queued + n_running + n_failed + n_succeeded) FROM tenants")
    (counted,), = service.ask("SELECT count(*) FROM jobs WHERE state IN ('queued', 'running', 'failed', 'succeeded')")
    faults.require(int(kept) == int(counted), f"the counters say {kept} jobs, the table has {counted}")


if __name__ == "__main__":
    main()
