"""Rows of `scale.py`: an API node that dies at 64 places of an upload, and a worker that is lost with its disk in every stage.
The second needs the feature `failpoints`, which makes each stage last long enough."""

import http.client
import json
import os
import random
import re
import shutil
import socket
import time

from cluster import Cluster, wait_for
from harness import require, sha256, take, until, wandless
from safety import STAGES, has_failpoints
from states import all_final, check_objects, strays, sweep

#: Places at which the API node dies: while it receives, and at fractions of the time between the last byte and the answer.
N_RECEIVING, N_RECORDING = 32, 27

#: And at these points of `failpoint.rs`.
POINTS = ["upload.spooled", "upload.synced", "publish.renamed", "upload.published", "upload.recorded"]


def upload_cut(options):
    """An API node is killed at 64 places of an upload: a repetition succeeds, every row has its object, and the sweep removes the rest."""
    cluster = Cluster(options.program, options.s3)
    try:
        with_points = has_failpoints(options.program)
        points = POINTS if with_points else []
        api = cluster.node("api")
        document = take(400, 4)
        body = json.dumps(document).encode()
        start = time.monotonic()
        first = sent(api.port, body, len(body))
        require(json.loads(first.getresponse().read())["id"], "an upload is refused")
        seconds = time.monotonic() - start
        places = [("byte", len(body) * n // N_RECEIVING) for n in range(N_RECEIVING)]
        places += [("second", seconds * n / N_RECORDING) for n in range(N_RECORDING + len(POINTS) - len(points))]
        places += [("point", name) for name in points]
        random.Random(options.seed).shuffle(places)
        acknowledged = 0
        for n, (kind, place) in enumerate(places):
            body = json.dumps({**document, "name": f"place {n}"}).encode()  # the same bytes would be the same session
            if kind == "point":
                api.kill()
                require(api.start(WANDLESS_FAILPOINT=place) is not None, "a node does not start")
            connection = sent(api.port, body, place if kind == "byte" else len(body))
            if kind == "second":
                time.sleep(place)
            if kind == "point":
                require(until(lambda: api.process.poll() is not None, 30), f"the node does not die at {place}")
            else:
                api.kill()
            acknowledged += is_accepted(connection)
            if n % 2:
                shutil.rmtree(api.data, ignore_errors=True)
            require(api.start() is not None, "a killed node does not start")
            require(not os.listdir(os.path.join(api.data, "tmp")), "the next start leaves what an upload had written")
            if n % 8 == 0:
                api.client().upload(take(10, seed=n))
        rows, objects = cluster.postgres.ask("SELECT id, sha256 FROM sessions"), cluster.store.objects("sessions")
        for session, digest in rows:
            require(f"sessions/{session}" in objects, f"the object of session {session} is missing")
            with open(objects[f"sessions/{session}"], "rb") as file:
                require(sha256(file.read()) == digest, f"session {session} has other bytes")
        require(len(rows) >= acknowledged + len(places) // 8, f"{acknowledged} uploads were answered 201, there are {len(rows)}")
        n_strays = len(strays(cluster))
        swept = sweep(cluster) if with_points else "0 (a program without failpoints)"
        return (f"killed at {len(places)} places ({len(points)} named): {acknowledged} answered, {len(rows)} sessions, all whole; "
                f"{n_strays} strays, {swept} swept")
    finally:
        cluster.remove()


def sent(port, body, n_bytes):
    """A connection on which so many bytes of an upload were sent."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.putrequest("POST", "/v1/sessions")
    for name, value in (("Content-Type", "application/json"), ("Content-Length", str(len(body)))):
        connection.putheader(name, value)
    connection.endheaders()
    connection.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.send(body[:n_bytes])
    return connection


def is_accepted(connection):
    """Whether the node had answered 201 before it died."""
    try:
        return connection.getresponse().status == 201
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def worker_lost(options):
    """A worker is lost with its disk in every stage: the next one runs no finished stage again, and the bytes are the same."""
    cluster = Cluster(options.program, options.s3, beat_s=0.3, lease_s=2.0)
    try:
        client = cluster.node("api").client()
        settings = {"WANDLESS_LOG": "info", "WANDLESS_LINGER_MS": "1500"}
        session = client.upload(take(200, 3, seed=2))["id"]
        job_options = {"extrinsics": "refine", "exports": []}
        worker = cluster.node("worker", **settings)
        expected = client.manifest(client.wait(client.submit(session, job_options)["id"])["id"])["files"]
        reused, lost_in = 0, []
        for stage in STAGES * options.losses:
            job = client.submit(session, job_options)["id"]
            before = STAGES[:STAGES.index(stage)]
            wait_for(lambda: set(before) <= kept(cluster, job) and client.job(job)["state"] == "running", 120, f"a worker is in the stage {stage}")
            require(client.job(job)["state"] not in wandless.FINAL, f"the job ended before its worker was lost in {stage}")
            worker.kill()
            finished = kept(cluster, job)
            lost_in.append(next((name for name in STAGES if name not in finished), "none"))
            worker.remove()
            worker = cluster.node("worker", **settings)
            done = client.wait(job)
            require(done["attempt"] == 1, f"the loss in {stage} counts as a crash")
            require(client.manifest(job)["files"] == expected, f"lost in {stage}: other bytes")
            again = [name for name in finished if name not in resumed(worker)]
            require(not again, f"lost in {stage}: {again} were run again")
            reused += len(finished)
        require(set(lost_in) == set(STAGES), f"lost in {lost_in} only")
        require(all_final(cluster), "a job has not ended")
        n_files, n_strays = check_objects(cluster)
        left = cluster.store.objects("checkpoints")
        require(not left, f"checkpoints of ended jobs are left: {sorted(left)[:3]}")
        swept = sweep(cluster)
        return (f"{len(lost_in)} workers and disks lost, once or more in each of {len(STAGES)} stages: {reused} finished stages reused, same bytes; "
                f"{n_files} objects right, {n_strays} strays, {swept} swept")
    finally:
        cluster.remove()


def kept(cluster, job):
    """Stages whose checkpoint is in the object store."""
    return {os.path.basename(key)[:-5] for key in cluster.store.objects(f"checkpoints/{job}") if key.endswith(".ckpt")}


def resumed(worker):
    """Stages that the worker took from checkpoints, by its log."""
    time.sleep(0.2)  # the last lines
    log = re.sub(r"(\x1b|\\x1b|\\u\{1b\})\[[0-9;]*m", "", "".join(worker.stderr)).replace("\\", "")
    lines = [line for line in log.splitlines() if "resumed from its checkpoint" in line]
    return {stage for line in lines for stage in re.findall(r'stage="(\w+)"', line)}
