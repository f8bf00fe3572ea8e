"""What the rows of `scale.py` read of a service of several machines."""

import subprocess

from harness import require, sha256

FIXED = {"extrinsics": "fixed", "exports": []}


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
