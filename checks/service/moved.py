"""A service of one machine that is moved to PostgreSQL and an object store (`wandless migrate --from`)."""

import http.server
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import threading
import time

from cluster import Cluster
from harness import Service, require, sha256, take, until, wandless

FIXED = {"extrinsics": "fixed", "exports": ["bvh"]}

#: What is the same before and after: not links, times of answers, or rates.
OF_JOB = ["id", "state", "session", "options", "labels", "created_at", "started_at", "finished_at", "attempt", "error", "quality", "stage_seconds"]


LABELS = {"take": "07", "ä": "ö" * 200}


class Receiver:
    """Answers every webhook with a status; counts them by id, and keeps the ids of each job."""

    def __init__(self, status=503):
        self.calls, self.ids = {}, {}
        receiver = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                job = json.loads(self.rfile.read(int(self.headers["content-length"])))["data"]["id"]
                name = self.headers["webhook-id"]
                receiver.calls[name] = receiver.calls.get(name, 0) + 1
                receiver.ids.setdefault(job, set()).add(name)
                self.send_response(status)
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


def moved(options):
    """Every job, result, key and webhook of the moved service is there, byte by byte; a second move and a damaged file are refused."""
    receiver = Receiver()
    words = ["--set", 'webhooks.allowed_networks=["127.0.0.1/32"]', "--set", "webhooks.first_wait_s=3600"]
    old = Service(options.previous or options.program, words=words)
    cluster = Cluster(options.program, options.s3)
    try:
        before, tokens, waiting = fill(old, receiver)
        refused(options, cluster, old.data, "another wandless service is using this data folder", code=1)
        old.process.send_signal(signal.SIGTERM)
        old.process.wait(30)
        untouched = folder_digests(old.data)
        damaged_folder_is_refused(options, cluster, old.data)
        interrupted_move(options, cluster, old.data)
        text = migrate(options, cluster, old.data)
        require(folder_digests(old.data) == untouched, "the moved folder was changed")
        refused(options, cluster, old.data, "the target is not empty: its table sessions has", code=2)
        require(not cluster.counters_differ(), f"counters differ: {cluster.counters_differ()}")
        node = cluster.node("all", *words)
        after = seen(node, tokens)
        for tenant, expected in before.items():
            for what, value in expected.items():
                require(after[tenant][what] == value, f"{what} of {tenant} differ: {value} {after[tenant][what]}")
        client = wandless.Client(f"http://127.0.0.1:{node.port}", key=tokens["studio"])
        require(repeat(client, waiting, receiver) == waiting["repeated"], "an Idempotency-Key is forgotten")
        require(client.wait(waiting["id"])["state"] == "succeeded", "the waiting job does not succeed")
        new = client.submit(waiting["session"], FIXED)["id"]
        require(client.wait(new)["state"] == "succeeded", "a new job does not succeed")
        wanted = client.artifact(waiting["repeated"], "people.json")
        is_same_solver = old.program == options.program  # another release may solve otherwise
        require(not is_same_solver or client.artifact(new, "people.json") == wanted, "a new job gives other bytes")
        require(all(count == 1 for count in receiver.calls.values()), f"webhooks were called again: {receiver.calls}")
        return text
    finally:
        cluster.remove()
        if old.process.poll() is None:
            old.kill()
        old.remove()


def fill(old, receiver):
    """A service with sessions, results, keys of two tenants, webhooks, a deleted session, labels, and a waiting job."""
    require(old.start() is not None, "the embedded service does not start")
    tokens = {tenant: create_key(old, tenant) for tenant in ("studio", "other")}
    clients = {tenant: wandless.Client(f"http://127.0.0.1:{old.port}", key=token) for tenant, token in tokens.items()}
    studio, other = clients["studio"], clients["other"]
    session = studio.upload(take(20))["id"]
    repeated = studio.submit(session, FIXED, labels=LABELS, webhook=receiver.url, key="again")["id"]
    corrected = studio.submit(session, {**FIXED, "people": 1}, priority=3)["id"]
    gone = studio.upload(take(12, seed=5))["id"]
    orphan = studio.submit(gone, {**FIXED, "fps": 25})["id"]
    ours = other.upload(take(20, seed=2))["id"]
    theirs = other.submit(ours, FIXED, webhook=receiver.url)["id"]
    for client, job in [(studio, repeated), (studio, corrected), (studio, orphan), (other, theirs)]:
        require(client.wait(job)["state"] == "succeeded", "a job does not succeed")
    studio.delete_session(gone)
    long = studio.upload(take(4000, 4))["id"]
    # The first one runs until the service stops, and both wait then.
    running = studio.submit(long, {"extrinsics": "fixed", "exports": []})["id"]
    require(until(lambda: studio.job(running)["state"] == "running", 30), "the long job does not start")
    canceled = studio.submit(session, FIXED)["id"]
    waiting = studio.submit(session, FIXED)["id"]
    studio.cancel(canceled)
    require(until(lambda: len(receiver.calls) == 2, 10), "the webhooks are not called")
    before = seen(old, tokens, skip={waiting})
    return before, tokens, {"id": waiting, "session": session, "repeated": repeated}


def repeat(client, waiting, receiver):
    """The request of the first job once more, under the same key."""
    return client.submit(waiting["session"], FIXED, labels=LABELS, webhook=receiver.url, key="again")["id"]


def create_key(service, tenant):
    command = [service.program, "key", "create", "--data", service.data, "--tenant", tenant, "--scopes", "read,write,metrics"]
    created = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return next(word for word in created.split() if word.startswith("wl_"))


def seen(service, tokens, skip=()):
    """What a tenant sees of its ended jobs and of its sessions, with the digest of every file."""
    found = {}
    for tenant, token in tokens.items():
        client = wandless.Client(f"http://127.0.0.1:{service.port}", key=token)
        ended = [job for job in client.jobs() if job["state"] in wandless.FINAL and job["id"] not in skip]
        ended.sort(key=lambda job: job["id"])
        done = [job["id"] for job in ended if job["state"] == "succeeded"]
        found[tenant] = {
            "jobs": [{name: job[name] for name in OF_JOB} for job in ended],
            "sessions": list(client.sessions()),
            "manifests": {job: client.manifest(job) for job in done},
            "files": {job: files(client, job) for job in done},
            "deliveries": {job["id"]: client.deliveries(job["id"]) for job in ended},
            "secret": client.webhook_secret(),
        }
    return found


def files(client, job):
    names = [file["name"] for file in client.manifest(job)["files"]]
    return {name: sha256(client.artifact(job, name)) for name in names}


def folder_digests(folder):
    """Digests of the files of a data folder. The log that SQLite writes beside the database is not compared, its rows are."""
    digests = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(place, name)
            if not name.startswith("wandless.db-"):
                with open(path, "rb") as file:
                    digests[os.path.relpath(path, folder)] = sha256(file.read())
    with sqlite3.connect(f"file:{folder}/wandless.db?mode=ro", uri=True) as database:
        digests["rows"] = sha256("\n".join(database.iterdump()).encode())
    return digests


def command(options, cluster, folder):
    environment = {**os.environ, "WANDLESS_STORE__URL": cluster.postgres.url("wandless"), "WANDLESS_BLOBS__URL": cluster.store.url,
                   "WANDLESS_LOG": "error", **cluster.store.environment}
    return dict(args=[options.program, "migrate", "--from", folder], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def migrate(options, cluster, folder):
    start = time.monotonic()
    done = subprocess.run(**command(options, cluster, folder))
    require(done.returncode == 0, f"migrate: {done.stderr}")
    summary = next(line for line in done.stdout.splitlines() if line.startswith("files: "))
    return f"{summary.split(';')[0]}; {time.monotonic() - start:.1f} s"


def refused(options, cluster, folder, expected, code):
    done = subprocess.run(**command(options, cluster, folder))
    require(done.returncode == code and expected in done.stderr, f"expected {expected!r}: {done.returncode} {done.stderr}")
    faults = [line for line in done.stderr.splitlines() if line.startswith("wandless: ")]
    require(len(faults) == 1, f"more than one line: {done.stderr}")


def damaged_folder_is_refused(options, cluster, folder):
    """A changed upload ends the move before a row is written."""
    copy = folder + "-damaged"
    shutil.copytree(folder, copy)
    upload = os.path.join(copy, "sessions", sorted(os.listdir(os.path.join(copy, "sessions")))[0])
    with open(upload, "r+b") as file:
        file.write(b"?")
    refused(options, cluster, copy, "1 files of the data folder are missing or damaged", code=1)
    shutil.rmtree(copy)
    require(cluster.postgres.ask("SELECT count(*) FROM sessions") == [["0"]], "a refused move has written rows")


def interrupted_move(options, cluster, folder):
    """A move that is killed at a random moment can be repeated."""
    for after in (0.05, 0.2, 0.5):
        process = subprocess.Popen(**command(options, cluster, folder))
        time.sleep(after)
        process.kill()
        process.communicate()
        if cluster.postgres.ask("SELECT count(*) FROM sessions") != [["0"]]:
            cluster.postgres.ask("DROP SCHEMA public CASCADE; CREATE SCHEMA public")  # it was complete: begin again
