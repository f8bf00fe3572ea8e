"""Rows of `scale.py`: workers and nodes that stand still, at a random moment or between two steps of the end of a job."""

import shutil
import signal
import time

from cluster import Cluster, wait_for
from growth import result_folder
from harness import require, take, until
from states import FIXED, at_work, check_objects, final_states

#: Points between the end of a job's process and the recorded end, at each of which a worker is stopped (`failpoint.rs`).
POINTS = ["child.ended", "result.hashed", "result.published", "finish.filled", "finish.written"]


def frozen_worker(options):
    """A worker that stood still for two leases publishes nothing when it goes on, and ends its child."""
    cluster = Cluster(options.program, options.s3, beat_s=0.3, lease_s=1.5)
    try:
        api = cluster.node("api")
        workers = [cluster.node("worker") for _ in range(2)]
        client = api.client()
        session = client.upload(take(300, 4))["id"]
        slowest = 0.0
        for _ in range(options.freezes):
            job = client.submit(session, FIXED)["id"]
            require(until(lambda: any(at_work(worker) for worker in workers), 30), "no worker takes the job")
            frozen = next(worker for worker in workers if at_work(worker))
            fence = claim_of(cluster, job)
            frozen.process.send_signal(signal.SIGSTOP)
            time.sleep(2 * cluster.lease_s + 1)
            require(claim_of(cluster, job) != fence, "the job was not put back")
            frozen.process.send_signal(signal.SIGCONT)
            slowest = max(slowest, wait_for(lambda: not at_work(frozen) or other_claim(cluster, job, frozen), 3, "the stale child ends"))
            client.wait(job)
        states = final_states(cluster)
        require(states == {"succeeded": options.freezes}, f"states: {states}")
        check_objects(cluster)
        return f"{options.freezes} freezes: 0 stale publications, child ended after {slowest:.2f} s at most"
    finally:
        cluster.remove()


def claim_of(cluster, job):
    return int(cluster.postgres.ask(f"SELECT fence FROM jobs WHERE id = '{job}'")[0][0])


def other_claim(cluster, job, worker):
    """Whether the frozen worker itself has claimed the job again: its child is then a new one."""
    return len(at_work(worker)) <= 1 and cluster.postgres.ask(f"SELECT state FROM jobs WHERE id = '{job}'")[0][0] == "running"


def frozen_at_the_end(options):
    """A worker that stands still between the end of its child and the recorded end publishes nothing, whether the job waits, runs
    elsewhere or has ended when it goes on. Needs the feature `failpoints`."""
    folder = result_folder(options)
    cluster = Cluster(options.program, options.s3, beat_s=0.3, lease_s=1.5)
    try:
        client = cluster.node("api").client()
        session = client.upload(take(8))["id"]
        met = {}
        for n in range(options.freezes):
            point, meets = POINTS[n % len(POINTS)], ["waits", "runs", "has ended"][n % 3]
            frozen = cluster.node("worker", WANDLESS_SIMULATED_JOB=f"100:{folder}", WANDLESS_STANDSTILL=point)
            job = client.submit(session, FIXED)["id"]
            require(until(lambda: stands_still(frozen), 30), f"the worker does not stop at {point}")
            stale = claim_of(cluster, job)
            wait_for(lambda: claim_of(cluster, job) > stale, cluster.lease_s + 15, f"the job of a worker at {point} is put back")
            other = None if meets == "waits" else successor(cluster, folder, 100 if meets == "has ended" else 4000)
            if meets == "runs":
                wait_for(lambda: client.job(job)["state"] == "running", 20, "another worker takes the job")
            if meets == "has ended":
                client.wait(job)
            frozen.process.send_signal(signal.SIGTERM)  # it claims nothing more when it goes on
            frozen.process.send_signal(signal.SIGCONT)
            require(until(lambda: frozen.process.poll() is not None, 30), "the worker does not stop")
            other = other or successor(cluster, folder, 100)
            client.wait(job)
            fence, published = map(int, cluster.postgres.ask(f"SELECT fence, result_fence FROM jobs WHERE id = '{job}'")[0])
            require(published == fence > stale, f"stale: claim {stale} has published at {point} although the job {meets}; now {fence}, {published}")
            other.kill()
            met[meets] = met.get(meets, 0) + 1
        require(final_states(cluster) == {"succeeded": options.freezes}, f"states: {final_states(cluster)}")
        n_files, n_strays = check_objects(cluster)
        return f"{options.freezes} workers stopped at {len(POINTS)} points, the job then {met}: 0 stale publications; {n_files} objects right, {n_strays} strays"
    finally:
        cluster.remove()
        shutil.rmtree(folder, ignore_errors=True)


def successor(cluster, folder, milliseconds):
    return cluster.node("worker", WANDLESS_SIMULATED_JOB=f"{milliseconds}:{folder}")


def stands_still(node):
    with open(f"/proc/{node.process.pid}/stat") as stat:
        return stat.read().rsplit(")", 1)[1].split()[0] == "T"


def away_from_many(options):
    """PostgreSQL is away under a hundred running jobs, all of which end meanwhile: none is put back, and claims go on when it is back.
    Needs the feature `failpoints`."""
    folder = result_folder(options)
    cluster = Cluster(options.program, options.s3, beat_s=2.0, lease_s=12.0)  # a hundred claims that beat again need some seconds
    try:
        client = cluster.node("api").client()
        session = client.upload(take(8))["id"]
        job_ms = int(1000 * options.away / 2) + 10_000  # the last are claimed some seconds before it dies
        for _ in range(4):
            cluster.node("worker", "--set", f"jobs.concurrent={options.running // 4}", WANDLESS_SIMULATED_JOB=f"{job_ms}:{folder}")
        for _ in range(options.running):
            client.submit(session, FIXED)
        wait_for(lambda: final_states(cluster).get("running") == options.running, 60, f"{options.running} jobs run")
        waiting = client.submit(session, FIXED)["id"]
        fences = dict(cluster.postgres.ask("SELECT id, fence FROM jobs WHERE state = 'running'"))
        cluster.postgres.kill()
        time.sleep(options.away)
        cluster.postgres.start()
        claimed = wait_for(lambda: claim_of(cluster, waiting) > 0, 60, "the waiting job is claimed")
        wait_for(lambda: final_states(cluster).get("succeeded", 0) >= options.running, 60, "the running jobs are recorded")
        now = dict(cluster.postgres.ask("SELECT id, result_fence FROM jobs"))
        lost = [job for job, fence in fences.items() if now[job] != fence]
        require(not lost, f"{len(lost)} of {len(fences)} running jobs were put back")
        require(claimed <= 5, f"the next claim came {claimed:.1f} s after the return")
        check_objects(cluster)
        return f"away for {options.away:.0f} s: 0 of {len(fences)} running jobs put back, all published, the next claim {claimed:.1f} s after its return"
    finally:
        cluster.remove()
        shutil.rmtree(folder, ignore_errors=True)
