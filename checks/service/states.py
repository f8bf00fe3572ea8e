"""What the rows of `scale.py` read of a service of several machines."""

import os
import subprocess
import time

from cluster import wait_for
from harness import Service, require, sha256

FIXED = {"extrinsics": "fixed", "exports": []}


def manifest_of_default(program, upload, options):
    """The manifest that the embedded default gives."""
    service = Service(program)
    try:
        require(service.start() is not None, "the embedded service does not start")
        client = service.client()
        return client.manifest(client.wait(client.submit(client.upload(upload)["id"], options)["id"])["id"])
    finally:
        service.kill()
        service.remove()


def final_states(cluster):
    return dict((state, int(n)) for state, n in cluster.postgres.ask("SELECT state, count(*) FROM jobs GROUP BY state"))


def at_work(node):
    """Process ids of the node's children that run a job."""
    found = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(node.process.pid)], capture_output=True, text=True)
    return [int(line.split()[0]) for line in found.stdout.splitlines() if "run-job" in line]


def check_objects(cluster):
    """Every file that a row names is there with its digest; of each job one claim has published."""
    require(not cluster.counters_differ(), f"counters differ from the jobs: {cluster.counters_differ()}")
    objects = cluster.store.objects("results")
    named = cluster.postgres.ask(
        "SELECT 'results/' || jobs.id || '/' || result_fence || '/' || sha256, sha256 FROM artifacts JOIN jobs ON jobs.id = job_id")
    for key, digest in named:
        require(key in objects, f"{key} is missing")
        with open(objects[key], "rb") as file:
            require(sha256(file.read()) == digest, f"{key} has other bytes")
    return len(named), len(set(objects) - {key for key, _ in named})


def all_final(cluster):
    return not {"queued", "running", "canceling"} & set(final_states(cluster))


def manifests_differ(cluster):
    """How many different lists of files the results of all jobs have: one where all jobs are the same."""
    lists = cluster.postgres.ask(
        "SELECT count(DISTINCT files) FROM (SELECT string_agg(name || sha256, ',' ORDER BY name) AS files FROM artifacts GROUP BY job_id) AS all_of")
    return int(lists[0][0])


def sweep(cluster):
    """Makes all objects two days old and lets a new leader sweep; returns how many it has removed. What rows name stays.
    Needs the feature `failpoints`, without which a leader sweeps once an hour."""
    for node in cluster.nodes:
        if node.process.poll() is None:
            node.kill()
    old, n_before = time.time() - 48 * 3600, 0
    for folder in ("sessions", "results", "checkpoints"):
        for path in cluster.store.objects(folder).values():
            os.utime(path, (old, old))
            n_before += 1
    node = cluster.node("api", WANDLESS_SWEEP_S="10")
    wait_for(lambda: not strays(cluster), 300, f"{len(strays(cluster))} strays are swept")
    check_objects(cluster)
    node.kill()
    return n_before - sum(len(cluster.store.objects(folder)) for folder in ("sessions", "results", "checkpoints"))


def strays(cluster):
    """Keys of the objects that no row names."""
    named = cluster.postgres.ask(
        """SELECT 'sessions/' || id FROM sessions
           UNION SELECT 'results/' || jobs.id || '/' || result_fence || '/' || sha256 FROM artifacts JOIN jobs ON jobs.id = job_id""")
    found = {key for folder in ("sessions", "results", "checkpoints") for key in cluster.store.objects(folder)}
    return found - {key for key, in named}
