"""Rows of `scale.py`: `wandless verify --undelete` on a bucket with versions, and restores to random seconds. Need moto
(pip install 'moto[server,s3]')."""

import importlib.util
import os
import random
import shutil
import subprocess
import sys
import time

from cluster import Cluster, Postgres, find, free_port, is_open, wait_for
from harness import require, sha256, take, until
from states import FIXED

KEYS = {"AWS_ACCESS_KEY_ID": "check", "AWS_SECRET_ACCESS_KEY": "check-secret", "AWS_REGION": "us-east-1", "AWS_ALLOW_HTTP": "true"}


class Bucket:
    """A bucket with versions on a server of moto."""

    def __init__(self, is_versioned):
        import boto3
        port = free_port()
        self.server = subprocess.Popen([sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
                                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        require(until(lambda: is_open(port), 30), "moto does not answer")
        self.environment = {**KEYS, "AWS_ENDPOINT": f"http://127.0.0.1:{port}", "WANDLESS_BLOBS__URL": "s3://versions/service"}
        self.s3 = boto3.client("s3", endpoint_url=self.environment["AWS_ENDPOINT"], region_name="us-east-1",
                               aws_access_key_id="check", aws_secret_access_key="check-secret")
        self.s3.create_bucket(Bucket="versions")
        if is_versioned:
            self.keep_versions()

    def keep_versions(self):
        self.s3.put_bucket_versioning(Bucket="versions", VersioningConfiguration={"Status": "Enabled"})

    def digest(self, key):
        """SHA-256 of an object; None where it is not there."""
        try:
            return sha256(self.s3.get_object(Bucket="versions", Key=f"service/{key}")["Body"].read())
        except self.s3.exceptions.NoSuchKey:
            return None

    def remove(self):
        self.server.kill()
        self.server.wait()


def brought_back(options):
    """Objects that were removed after the second to which the database was restored are brought back; without versions it says so."""
    if not importlib.util.find_spec("moto"):
        return "skipped: moto is not installed"
    cluster, bucket = Cluster(options.program, options.s3), Bucket(is_versioned=False)
    environment, s3 = bucket.environment, bucket.s3
    try:
        node = cluster.node("all", **environment)
        client = node.client()
        job = client.submit(client.upload(take(8))["id"], FIXED)["id"]
        client.wait(job)
        before = client.manifest(job)["files"]
        node.stop()

        def verify(*words):
            return verified(options, bucket, cluster.postgres, *words)

        code, text = verify("--undelete")
        require(code == 1 and "keeps no versions" in text, f"without versions: {code} {text}")
        bucket.keep_versions()
        # Checkpoints of an ended job may still be there: their removal stops with the node, and the sweep makes up for it.
        is_named = lambda key: "/clock" not in key and not key.endswith(".ckpt")
        keys = [one["Key"] for one in s3.list_objects_v2(Bucket="versions")["Contents"] if is_named(one["Key"])]
        for key in keys:  # written again, so that each has a version
            s3.put_object(Bucket="versions", Key=key, Body=s3.get_object(Bucket="versions", Key=key)["Body"].read())
        removed, changed = keys[::2], keys[1]
        for key in removed:
            s3.delete_object(Bucket="versions", Key=key)
        s3.put_object(Bucket="versions", Key=changed, Body=b"other bytes")
        code, text = verify()
        require(code == 1 and f"{len(removed) + 1} damaged" in text, f"verify: {code} {text}")
        code, text = verify("--undelete")
        require(code == 0 and f"{len(removed) + 1} brought back, 0 damaged" in text, f"undelete: {code} {text}")
        require(verify()[0] == 0, "an object is still missing")
        fresh = cluster.node("api", **environment).client()
        require(fresh.manifest(job)["files"] == before, "the manifest differs")
        for file in before:
            fresh.artifact(job, file["name"])
        return f"{len(removed)} of {len(keys)} objects removed, one overwritten: all brought back and read"
    finally:
        bucket.remove()
        cluster.remove()


def verified(options, bucket, postgres, *words):
    given = {**os.environ, **bucket.environment, "WANDLESS_STORE__URL": postgres.url("wandless"), "WANDLESS_LOG": "error"}
    done = subprocess.run([options.program, "verify", *words], capture_output=True, text=True, env=given)
    return done.returncode, done.stdout + done.stderr


class Archive:
    """The archived log of a server and a copy of its data, from which any later second is restored."""

    def __init__(self, postgres):
        self.postgres, self.log = postgres, os.path.join(postgres.folder, "archive")
        self.base = os.path.join(postgres.folder, "base")
        os.mkdir(self.log)
        if postgres.user:
            shutil.chown(self.log, 65534)
        with open(os.path.join(postgres.data, "postgresql.conf"), "a") as file:
            file.write(f"archive_mode=on\narchive_command='cp %p {self.log}/%f'\nwal_level=replica\n")
        postgres.run("pg_ctl", "-D", postgres.data, "-m", "fast", "-w", "stop")
        postgres.start()
        postgres.run("pg_basebackup", "-d", postgres.url("postgres"), "-D", self.base, "-c", "fast", "-X", "none")

    def complete(self):
        """Until all of the log is archived. A server goes back only to seconds before its last transaction."""
        self.postgres.ask("CREATE TABLE afterwards ()", "postgres")
        name = self.postgres.ask("SELECT pg_walfile_name(pg_switch_wal())")[0][0]
        wait_for(lambda: os.path.exists(os.path.join(self.log, name)), 60, "the log is archived")

    def restored(self, second):
        """A server with the state of that time."""
        place = os.path.join(self.postgres.folder, "restored")
        shutil.rmtree(place, ignore_errors=True)
        subprocess.run(["cp", "-a", self.base, place], check=True)
        port = free_port()
        with open(os.path.join(place, "postgresql.auto.conf"), "a") as file:
            file.write(f"port={port}\narchive_mode=off\nfsync=off\nrestore_command='cp {self.log}/%f %p'\n"
                       f"recovery_target_time='{second}'\nrecovery_target_action='promote'\n")
        with open(os.path.join(place, "recovery.signal"), "w"):
            pass
        return Restored(self.postgres, place, port)


class Restored(Postgres):
    """A server on a restored folder."""

    def __init__(self, original, place, port):
        self.folder, self.data, self.port, self.user = original.folder, place, port, original.user
        for name in ("recovery.signal", "postgresql.auto.conf"):
            if self.user:
                shutil.chown(os.path.join(place, name), 65534)
        self.start()
        wait_for(lambda: self.ask("SELECT pg_is_in_recovery()", "postgres") == [["f"]], 60, "the server is restored")

    def remove(self):
        subprocess.run([*self.user, find("pg_ctl"), "-D", self.data, "-m", "immediate", "-w", "stop"], capture_output=True)
        shutil.rmtree(self.data, ignore_errors=True)


def restores(options):
    """The database is restored to random seconds of a time in which jobs came, ended and were deleted: every object that a row of that second
    names is there and right after `verify --undelete`."""
    if not importlib.util.find_spec("moto"):
        return "skipped: moto is not installed"
    cluster, bucket, dice = Cluster(options.program, options.s3, durable=False), Bucket(is_versioned=True), random.Random(options.seed)
    try:
        archive = Archive(cluster.postgres)
        client = cluster.node("all", **bucket.environment).client()
        (first,), = cluster.postgres.ask("SELECT extract(epoch FROM clock_timestamp())")
        counts = changes(client, dice, options.restore_s)
        (last,), = cluster.postgres.ask("SELECT extract(epoch FROM clock_timestamp())")
        cluster.nodes[0].stop()
        archive.complete()
        n_named, n_back = 0, 0
        for _ in range(options.restores):
            moment = dice.uniform(float(first), float(last))
            second, = cluster.postgres.ask(f"SELECT to_timestamp({moment})")[0]
            server = archive.restored(second)
            try:
                if server.ask("SELECT to_regclass('jobs')") == [[""]]:
                    continue  # before the tables
                code, text = verified(options, bucket, server, "--undelete")
                require(code == 0, f"restored to {second}: {text}")
                named = server.ask("SELECT 'sessions/' || id, sha256 FROM sessions UNION SELECT 'results/' || jobs.id || '/' || result_fence || '/' || sha256, "
                                   "sha256 FROM artifacts JOIN jobs ON jobs.id = job_id")
                wrong = [key for key, digest in named if bucket.digest(key) != digest]
                require(not wrong, f"restored to {second}: {len(wrong)} of {len(named)} objects are missing or wrong: {wrong[:2]}")
                n_named += len(named)
                n_back += int(text.split(" brought back")[0].split()[-1])
            finally:
                server.remove()
        require(n_back > 0, "no object had to be brought back, so nothing was tested")
        return f"{options.restores} restores in {float(last) - float(first):.0f} s of {counts}: {n_named} named objects there and right, {n_back} brought back"
    finally:
        bucket.remove()
        cluster.remove()


def changes(client, dice, seconds):
    """Uploads, jobs and deletions for some time; returns their numbers."""
    counts, sessions, jobs, end = {"uploads": 0, "jobs": 0, "deletions": 0}, [], [], time.monotonic() + seconds
    while time.monotonic() < end:
        sessions.append(client.upload(take(8, seed=dice.randrange(1 << 30)))["id"])
        jobs.append(client.submit(sessions[-1], FIXED)["id"])
        counts["uploads"], counts["jobs"] = counts["uploads"] + 1, counts["jobs"] + 1
        if len(jobs) > 3:  # the oldest has ended, mostly
            client.wait(jobs[0])
            client.delete_job(jobs.pop(0))
            client.delete_session(sessions.pop(0))
            counts["deletions"] += 2
    return counts
