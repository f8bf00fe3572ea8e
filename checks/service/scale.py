"""A service of several machines: PostgreSQL, an object store, API nodes and workers. Each row is one promise.

    cargo build --release --features scale
    python3 checks/service/scale.py --program target/release/wandless [--s3 s3s-fs] [--row kills] [--jobs 40 --kills 30]

Needs PostgreSQL 15 or newer (initdb, pg_ctl, psql). The S3 server is s3s-fs; without it the objects are in a folder that all nodes
share, which is said.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time

from cluster import Cluster, Postgres, find, wait_for
from broken import broken_store, cut_off, large_upload, lost_answers, paused_transaction, wrong_clocks
from frozen import away_from_many, frozen_at_the_end, frozen_worker
from growth import more_cores, more_workers
from harness import Failed, Service, percentile, require, take, until, wandless
from lost import upload_cut, worker_lost
from moved import Receiver, moved
from restored import brought_back, restores
from states import FIXED, all_final, check_objects, final_states, manifest_of_default
from storm import storm
from upgrades import two_releases

def two_api_nodes(options):
    """Two API nodes and two workers are one service, and give the bytes of the embedded default."""
    expected = manifest_of_default(options.program, take(30), FIXED)
    cluster = Cluster(options.program, options.s3)
    try:
        nodes = [cluster.node("api") for _ in range(2)]
        api = [node.client() for node in nodes]
        workers = [cluster.node("worker") for _ in range(2)]
        session = api[0].upload(take(30))["id"]
        jobs = [api[n % 2].submit(session, FIXED)["id"] for n in range(4)]
        manifests = [api[(n + 1) % 2].manifest(api[n % 2].wait(job)["id"]) for n, job in enumerate(jobs)]
        require(all(manifest == expected for manifest in manifests), "a manifest differs from that of the embedded service")
        boots = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE state = 'succeeded'")
        require(boots == [["4"]], f"jobs: {boots}")
        status, _ = probe(workers[0], "/v1/jobs")
        require(status == 404 and probe(workers[0], "/readyz")[0] == 200, "a worker serves the probes only")
        seen, cancels = [], []
        long = api[0].upload(take(2000, 4))["id"]  # still being solved when it is canceled, on any machine
        for n in range(options.changes):
            job = api[0].submit(long, FIXED)["id"]
            api[1].job(job)
            noticed = threading.Event()
            threading.Thread(target=lambda job=job, noticed=noticed: (follow_to_end(nodes[1].client(), job), noticed.set()), daemon=True).start()
            time.sleep(random.uniform(0.1, 0.6))
            start = time.monotonic()
            api[0].cancel(job)
            require(until(lambda job=job: api[0].job(job)["state"] in wandless.FINAL, 10), "a canceled job does not end")
            cancels.append(time.monotonic() - start)
            ended = time.monotonic()
            require(noticed.wait(10), "the other API node does not notice the end")
            seen.append(max(0.0, time.monotonic() - ended))
        require(percentile(seen, 0.99) <= 1.5 and max(cancels) <= 2.0, f"noticed after {max(seen):.2f} s, canceled after {max(cancels):.2f} s")
        n_files, strays = check_objects(cluster)
        return (f"4 manifests equal; {n_files} objects, {strays} strays; end noticed on the other node: p50 {percentile(seen, 0.5) * 1000:.0f} ms, "
                f"p99 {percentile(seen, 0.99) * 1000:.0f} ms; cancel: max {max(cancels):.2f} s")
    finally:
        cluster.remove()


def probe(node, path):
    from harness import get
    return get(node.port, path)


def follow_to_end(client, job):
    state = None
    while state not in wandless.FINAL:
        state = client.job(job, wait_s=30)["state"]


def kills(options):
    """Nodes are killed at random: every job ends once, no crash is counted, no object is lost."""
    cluster = Cluster(options.program, options.s3)
    try:
        api = cluster.node("api")
        workers = [cluster.node("worker") for _ in range(options.workers)]
        client = api.client()
        session = client.upload(take(30))["id"]
        jobs = [client.submit(session, FIXED)["id"] for _ in range(options.jobs)]
        dice, n_kills, start = random.Random(options.seed), 0, time.monotonic()
        while n_kills < options.kills and not all_final(cluster):
            time.sleep(dice.uniform(0.2, 1.5))
            victim = dice.choice(workers if dice.random() < 0.85 else [api])
            victim.kill()
            n_kills += 1
            cluster.restart(victim)
        wait_for(lambda: all_final(cluster), 600, "all jobs end")
        states = final_states(cluster)
        require(states == {"succeeded": options.jobs}, f"states: {states}")
        crashes = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE crashes > 0 OR attempt > 1")
        require(crashes == [["0"]], f"a kill was counted as a crash: {crashes}")
        manifests = {repr(client.manifest(job)) for job in jobs[:5]}
        require(len(manifests) == 1, "results differ")
        n_files, strays = check_objects(cluster)
        return (f"{options.jobs} jobs, {n_kills} kills in {time.monotonic() - start:.0f} s: 0 lost, 0 doubled, {n_files} objects right, "
                f"{strays} strays for the sweep, counters exact")
    finally:
        cluster.remove()


def database_away(options):
    """PostgreSQL dies under running jobs and comes back: no claim is lost, every result is published, requests get 503 meanwhile."""
    cluster = Cluster(options.program, options.s3)
    try:
        api = cluster.node("api")
        for _ in range(2):
            cluster.node("worker")
        client = api.client()
        session = client.upload(take(400, 4))["id"]
        jobs = [client.submit(session, FIXED)["id"] for _ in range(4)]
        require(until(lambda: final_states(cluster).get("running") == 2, 30), "no worker takes a job")
        fences = dict(cluster.postgres.ask("SELECT id, fence FROM jobs WHERE state = 'running'"))
        cluster.postgres.kill()
        time.sleep(1)
        start = time.monotonic()
        status, _ = probe(api, f"/v1/jobs/{jobs[0]}")
        require(status == 503 and time.monotonic() - start < 8, f"{status} after {time.monotonic() - start:.1f} s without a database")
        time.sleep(max(0.0, options.away - (time.monotonic() - start)))
        cluster.postgres.start()
        back = time.monotonic()
        require(until(lambda: probe(api, "/readyz")[0] == 200, 15), "the API does not come back")
        ready = time.monotonic() - back
        wait_for(lambda: all_final(cluster), 300, "all jobs end")
        require(final_states(cluster) == {"succeeded": 4}, f"states: {final_states(cluster)}")
        now = dict(cluster.postgres.ask("SELECT id, result_fence FROM jobs"))
        lost = [job for job, fence in fences.items() if now[job] != fence]
        require(not lost, f"{len(lost)} running jobs were put back")
        check_objects(cluster)
        return f"away for {options.away:.0f} s: 0 of {len(fences)} running jobs put back, ready {ready:.1f} s after its return"
    finally:
        cluster.remove()


def turns_of_tenants(options):
    """The one job of a tenant has the second turn beside the many of another, of which never more than three run at once."""
    cluster = Cluster(options.program, options.s3)
    try:
        words = ["--set", "tenants.max_running=3", "--set", "jobs.concurrent=4"]
        api = cluster.node("api", *words)
        clients = {}
        for tenant in ("many", "one"):
            environment = {**os.environ, "WANDLESS_STORE__URL": cluster.postgres.url("wandless"), "WANDLESS_BLOBS__URL": cluster.store.url,
                           **cluster.store.environment, "WANDLESS_DATA": api.data}
            created = subprocess.run([options.program, "key", "create", "--tenant", tenant], capture_output=True, text=True, env=environment)
            clients[tenant] = api.client(key=created.stdout.strip())
        sessions = {tenant: client.upload(take(8))["id"] for tenant, client in clients.items()}
        for _ in range(options.jobs):
            clients["many"].submit(sessions["many"], FIXED)
        enough = min(options.jobs, 60)  # of many thousands the first show the turns
        one = clients["one"].submit(sessions["one"], FIXED)["id"]
        for _ in range(3):
            cluster.node("worker", *words)
        most = 0
        while not all_final(cluster) and final_states(cluster).get("succeeded", 0) <= enough:
            rows = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE tenant = 'many' AND state IN ('running', 'canceling')")
            most = max(most, int(rows[0][0]))
            time.sleep(0.02)
        require(most <= 3, f"{most} jobs of a tenant ran at once")
        order = [row[0] for row in cluster.postgres.ask("SELECT id FROM jobs WHERE started_at IS NOT NULL ORDER BY started_at, seq")]
        require(one in order[:3], f"the only job of a tenant was not among the first three claims of {len(order)}")
        check_objects(cluster)
        return f"the only job was claimed as number {order.index(one) + 1} beside {options.jobs}; at most {most} of a tenant at once"
    finally:
        cluster.remove()


def leader_killed(options):
    """Another node becomes the leader, puts back the jobs of the dead one, and calls its webhooks: at least once, always with the same id."""
    cluster, receiver = Cluster(options.program, options.s3), Receiver(status=200)
    try:
        words = ["--set", 'webhooks.allowed_networks=["127.0.0.1/32"]']
        nodes = [cluster.node("all", *words) for _ in range(3)]
        session = nodes[0].client().upload(take(8))["id"]
        wait_for(lambda: cluster.leader() is not None, 10, "a leader")
        slowest, jobs = 0.0, []
        for n in range(options.leaders):
            jobs.append(nodes[n % 3].client().submit(session, FIXED, webhook=receiver.url)["id"])
            time.sleep(random.uniform(0.0, 1.0))
            old = cluster.leader()
            victim = next(node for node in nodes if holds(node, cluster, old))
            victim.kill()
            slowest = max(slowest, wait_for(lambda old=old: cluster.leader() not in (None, old), 10, "the next leader"))
            cluster.restart(victim)
        wait_for(lambda: all_final(cluster), 120, "all jobs end")
        require(final_states(cluster) == {"succeeded": options.leaders}, f"states: {final_states(cluster)}")
        wait_for(lambda: set(jobs) <= set(receiver.ids), 60, "every job has its webhook")
        twice = [job for job in jobs if len(receiver.ids[job]) != 1]
        require(not twice, f"{len(twice)} jobs had webhooks with different ids")
        repeated = sum(receiver.calls.values()) - len(receiver.calls)
        return f"{options.leaders} leaders killed: the next one after {slowest:.1f} s at most; {len(jobs)} webhooks, {repeated} repeated with the same id"
    finally:
        cluster.remove()


def holds(node, cluster, backend):
    """Whether the connection of the server belongs to the node: by the port of its socket."""
    port = cluster.postgres.ask(f"SELECT client_port FROM pg_stat_activity WHERE pid = {backend}")[0][0]
    sockets = subprocess.run(["ls", "-l", f"/proc/{node.process.pid}/fd"], capture_output=True, text=True).stdout
    with open("/proc/net/tcp") as table:
        for line in table:
            words = line.split()
            if words[1].endswith(f":{int(port):04X}") and f"socket:[{words[9]}]" in sockets:
                return True
    return False


def refused(options):
    """Combinations that would lose data are refused with one clear line that has no secret."""
    server = Postgres(durable=False)
    try:
        server.create("wandless")
        url = f"postgres://postgres:pass-word@127.0.0.1:{server.port}/wandless"
        folder = tempfile.mkdtemp(prefix="wandless-objects-")

        def start(words, environment, expected, code=2):
            data = tempfile.mkdtemp(prefix="wandless-check-")
            done = subprocess.run([options.program, "serve", "--listen", "127.0.0.1:0", "--data", data, *words], capture_output=True, text=True,
                                  env={**os.environ, "WANDLESS_LOG": "error", **environment}, timeout=60)
            shutil.rmtree(data)
            text = done.stderr.strip()
            require(done.returncode == code and expected in text and "pass-word" not in text, f"{words} {done.returncode}: {text}")
            require(len(text.splitlines()) == 1, f"more than one line: {text}")

        start(["--role", "worker"], {}, "store.url is sqlite:")
        start([], {"WANDLESS_STORE__URL": url}, "blobs.url is file:")
        start([], {"WANDLESS_STORE__URL": "mysql://a:pass-word@b/c", "WANDLESS_BLOBS__URL": f"file://{folder}"}, "store.url: expected", 1)
        start([], {"WANDLESS_STORE__URL": url, "WANDLESS_BLOBS__URL": "ftp://x"}, "blobs.url is ftp://x", 1)
        start(["--set", "worker.lease_s=6"], {}, "worker.lease_s is 6")
        printed = subprocess.run([options.program, "serve", "--print-settings"], capture_output=True, text=True,
                                 env={**os.environ, "WANDLESS_STORE__URL": url, "WANDLESS_BLOBS__URL": f"file://{folder}"})
        require("pass-word" not in printed.stdout and "postgres://" in printed.stdout, "--print-settings prints the password")
        node = Service(options.program, environment={"WANDLESS_STORE__URL": url, "WANDLESS_BLOBS__URL": f"file://{folder}"})
        require(node.start() is not None, "the service does not start")
        node.client().upload(take(10))
        node.kill()
        other = tempfile.mkdtemp(prefix="wandless-objects-")
        start([], {"WANDLESS_STORE__URL": url, "WANDLESS_BLOBS__URL": f"file://{other}"}, f"the uploads and results of this database are in file://{folder}", 1)
        node.remove()
        for place in (folder, other):
            shutil.rmtree(place)
        return "7 combinations refused, one line each, no password shown"
    finally:
        server.remove()


ROWS = [two_api_nodes, kills, frozen_worker, database_away, leader_killed, refused, moved, lost_answers, paused_transaction, wrong_clocks,
        broken_store, cut_off, large_upload, turns_of_tenants, upload_cut, brought_back, restores]

#: Rows that are run by `--row` alone: the first needs a capture, the others a program with the feature `failpoints`.
ALONE = [more_cores, more_workers, storm, frozen_at_the_end, away_from_many, worker_lost, two_releases]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", default="target/release/wandless")
    parser.add_argument("--s3", default=shutil.which("s3s-fs"), help="the program s3s-fs")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--row", choices=[row.__name__ for row in [*ROWS, *ALONE]], help="one row")
    for name, default in {"jobs": 12, "kills": 10, "workers": 3, "changes": 10, "freezes": 3, "leaders": 5, "eaten": 5,
                          "pauses": 2, "uploads": 6, "upload-mib": 2048, "growth-jobs": 12, "solves": 20,
                          "job-ms": 800, "running": 100, "losses": 1, "upgrades": 1, "restores": 3, "restore-s": 20}.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--capture", help="a session, folder or zip, for the solves of `more_cores`")
    parser.add_argument("--previous", help="the program of the previous release, which makes the folder that is moved")
    parser.add_argument("--every", type=float, default=0.5, help="mean seconds between two kills of the storm")
    parser.add_argument("--between", type=float, default=2.0, help="seconds between two restarts of an upgrade")
    parser.add_argument("--growth", type=float, default=7.5, help="least ratio of the rates of 8 workers and of one")
    parser.add_argument("--cut", type=float, default=20.0, help="seconds without one of the servers")
    parser.add_argument("--away", type=float, default=10.0, help="seconds without a database")
    options = parser.parse_args()
    missing = [name for name in ("initdb", "pg_ctl", "psql") if not find(name)]
    if missing:
        print(f"SKIPPED: {', '.join(missing)} of PostgreSQL are not installed", flush=True)
        sys.exit(0)
    print(f"seed {options.seed}", flush=True)
    failed = False
    for row in [*ROWS, *ALONE]:
        if options.row != row.__name__ and (options.row is not None or row in ALONE):
            continue
        start = time.monotonic()
        try:
            print(f"{row.__name__}: {row(options)} ({time.monotonic() - start:.0f} s)", flush=True)
        except (Failed, wandless.Problem, wandless.JobFailed) as fault:
            failed = True
            print(f"{row.__name__}: FAULT {fault}", flush=True)
    print("FAILED" if failed else "passed")
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
