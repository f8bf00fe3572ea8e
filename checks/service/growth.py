"""Row of `scale.py`: more workers end more jobs. Needs a program with the feature `failpoints`, which simulates jobs."""

import os
import shutil
import tempfile

from cluster import Cluster, wait_for
from harness import Service, require, take
from states import FIXED, all_final, check_objects, manifest_of_default

#: Duration of a simulated job, ms.
JOB_MS = 500

#: Seconds between two looks at simulated jobs and at real ones: the rows measure how busy machines are, and looking costs a part of one.
PAUSE_S = 1.0
LONG_PAUSE_S = 10.0


def result_folder(options):
    """The files of one real result, which simulated jobs publish."""
    alone, folder = Service(options.program), tempfile.mkdtemp(prefix="wandless-result-")
    os.chmod(folder, 0o755)
    try:
        require(alone.start() is not None, "the embedded service does not start")
        client = alone.client()
        client.download(client.wait(client.submit(client.upload(take(8))["id"], FIXED)["id"])["id"], folder)
        os.remove(os.path.join(folder, "manifest.json"))
    finally:
        alone.kill()
        alone.remove()
    return folder


def more_workers(options):
    """Eight workers end simulated jobs at 7.5 times the rate of one. They and the object store share this machine's disk, whose file
    system may be the limit (TMPDIR on one in memory shows it)."""
    folder = result_folder(options)
    rates = {}
    try:
        for n_workers in (1, 8):
            cluster = Cluster(options.program, options.s3)
            try:
                client = cluster.node("api").client()
                session = client.upload(take(8))["id"]
                simulated = {"WANDLESS_SIMULATED_JOB": f"{JOB_MS}:{folder}"}
                n_jobs = options.growth_jobs * n_workers
                for _ in range(n_jobs):
                    client.submit(session, FIXED)
                for _ in range(n_workers):
                    cluster.node("worker", **simulated)
                wait_for(lambda cluster=cluster: all_final(cluster), 300, "all jobs end", PAUSE_S)
                span = cluster.postgres.ask(
                    "SELECT extract(epoch FROM max(finished_at::timestamptz) - min(started_at::timestamptz)) FROM jobs WHERE state = 'succeeded'")
                ended = int(cluster.postgres.ask("SELECT count(*) FROM jobs WHERE state = 'succeeded'")[0][0])
                require(ended == n_jobs, f"{ended} of {n_jobs} jobs succeeded")
                rates[n_workers] = n_jobs / float(span[0][0])
                if rates[n_workers] > n_workers * 1000 / JOB_MS:
                    return "skipped: the program was built without the feature failpoints, so that jobs are not simulated"
                check_objects(cluster)
            finally:
                cluster.remove()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    ratio = rates[8] / rates[1]
    require(ratio >= options.growth, f"8 workers are {ratio:.1f} times as fast as one: {rates}")
    return f"1 worker {rates[1]:.2f} jobs/s, 8 workers {rates[8]:.2f}: {ratio:.2f} times"


def more_cores(options):
    """Two workers of one core each end real solves at 1.9 times the rate of one, and give the bytes of the embedded default."""
    if not options.capture:
        return "skipped: --capture names no session"
    if os.path.isfile(options.capture):
        return of_cores(options, options.capture)
    with tempfile.TemporaryDirectory(prefix="wandless-capture-") as folder:
        return of_cores(options, shutil.make_archive(os.path.join(folder, "session"), "zip", options.capture))


def of_cores(options, upload):
    expected = manifest_of_default(options.program, upload, {})
    rates = {}
    for n_workers in (1, 2):
        cluster = Cluster(options.program, options.s3)
        try:
            client = cluster.node("api").client()
            session = client.upload(upload)["id"]
            jobs = [client.submit(session, {})["id"] for _ in range(options.solves)]
            words = ["--set", "jobs.concurrent=1", "--set", "jobs.threads=1"]
            for core in range(n_workers):
                cluster.node("worker", *words, prefix=["taskset", "-c", str(core)])
            wait_for(lambda cluster=cluster: all_final(cluster), 1800, "all jobs end", LONG_PAUSE_S)
            require(all(client.manifest(job) == expected for job in jobs), "a manifest differs from that of the embedded service")
            span = cluster.postgres.ask("SELECT extract(epoch FROM max(finished_at::timestamptz) - min(started_at::timestamptz)) FROM jobs")
            rates[n_workers] = options.solves / float(span[0][0])
            check_objects(cluster)
        finally:
            cluster.remove()
    ratio = rates[2] / rates[1]
    require(ratio >= 1.9, f"two workers are {ratio:.2f} times as fast as one: {rates}")
    return f"{options.solves} solves each: {rates[1]:.3f} and {rates[2]:.3f} a second, {ratio:.2f} times; every manifest equal to the embedded default's"
