"""A1, A2, A3: kills the service at random times and at every failpoint, and checks that nothing acknowledged is lost.

    python3 checks/service/crashes.py --kills 200
    cargo build --release --features failpoints --target-dir target/failpoints
    python3 checks/service/crashes.py --kills 0 --points 1 --program target/failpoints/release/wandless
    python3 checks/service/crashes.py --kills 0 --lost 60 --program target/failpoints/release/wandless

Clients record every 2xx response. After the last restart every job that was answered 202 must exist, be final within 60 s
and have at most one result, with the right digest of every file; its webhook must have been called; SQLite's integrity
check and `wandless verify` must pass. `--lost`: the same after seconds in which one in three COMMITs is made but looks failed.
"""

import http.server
import json
import os
import random
import re
import signal
import subprocess
import threading
import time

from harness import Faults, Service, arguments, sha256, take, wandless

WORDS = ["--set", "webhooks.allowed_networks=['127.0.0.1']", "--set", "webhooks.first_wait_s=1"]
HERE = os.path.dirname(os.path.abspath(__file__))


def points():
    """Returns the names of all failpoints of the program."""
    with open(os.path.join(HERE, "..", "..", "src", "service", "failpoint.rs")) as source:
        table = source.read().split("FAILPOINTS", 1)[1].split("];", 1)[0]
    return re.findall(r'"([a-z.]+)"', table)


class Receiver:
    """Receives webhooks and records the reported states by job."""

    def __init__(self):
        calls = self.calls = {}

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                event = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                calls.setdefault(event["data"]["id"], []).append(event["data"]["state"])
                self.send_response(204)
                self.end_headers()

            def log_message(self, *words):
                pass

        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{server.server_port}/"


# Maximal number of queued jobs of one client.
MAX_WAITING = 5


class Ledger:
    """Everything that the service has acknowledged."""

    def __init__(self):
        self.lock = threading.Lock()
        self.sessions, self.jobs, self.canceled, self.deleted, self.extended = {}, {}, set(), set(), set()
        self.receiver = Receiver()


def work(service, ledger, seed, over, n_frames):
    """One client: uploads, submits, cancels and deletes until `over` is set; errors caused by kills are ignored."""
    dice = random.Random(seed)
    n, waiting = 0, []
    while not over.is_set():
        client = service.client(patience_s=0.0, timeout_s=10.0)
        n += 1
        if len(waiting) >= MAX_WAITING:
            # The accepted work must be small enough to finish within the 60 s.
            try:
                waiting = [job for job in waiting if not is_over(client, job)]
            except (wandless.Problem, OSError, wandless.http.client.HTTPException, ValueError):
                pass
            time.sleep(0.05)
            continue
        key = f"{seed}-{n}"
        try:
            session = client.upload(take(n_frames, seed=1000 * seed + n))
            with ledger.lock:
                ledger.sessions[session["id"]] = session["sha256"]
            if dice.random() < 0.2:
                with ledger.lock:
                    del ledger.sessions[session["id"]]  # deletion requested, whatever the response
                client.delete_session(session["id"])
                continue
            options = {"extrinsics": "fixed", "exports": []}
            job = client.submit(session["id"], options=options, key=key, webhook=ledger.receiver.url)
            with ledger.lock:
                ledger.jobs[job["id"]] = session["id"]
            waiting.append(job["id"])
            again = client.submit(session["id"], options=options, key=key, webhook=ledger.receiver.url)
            with ledger.lock:
                if again["id"] != job["id"]:
                    ledger.jobs["twice " + again["id"]] = job["id"]
            fate = dice.random()
            if fate < 0.15:
                client.cancel(job["id"])
                with ledger.lock:
                    ledger.canceled.add(job["id"])
            elif fate < 0.3:
                with ledger.lock:
                    ledger.deleted.add(job["id"])  # deletion requested, whatever the response
                client.delete_job(job["id"])
            oldest = waiting[0]
            if oldest not in ledger.extended and is_over(client, oldest):
                with ledger.lock:
                    ledger.extended.add(oldest)
                client.json("POST", f"/v1/jobs/{oldest}/exports", body=json.dumps({"exports": ["calib_toml"]}).encode(),
                            media_type="application/json")
            time.sleep(dice.uniform(0.0, 0.3))
        except (wandless.Problem, OSError, wandless.http.client.HTTPException, ValueError):
            time.sleep(0.02)


def is_over(client, job):
    try:
        return client.job(job)["state"] in wandless.FINAL
    except wandless.Problem as problem:
        if problem.status == 404:
            return True  # deleted; `check_promises` reports lost jobs
        raise


def check_promises(service, ledger, faults):
    """Checks all acknowledged requests after the last restart."""
    client = service.client()
    deadline = time.monotonic() + 60
    finals = {}
    for job in ledger.jobs:
        faults.require(not job.startswith("twice"), f"one key, two jobs: {job}")
        if job in ledger.deleted:
            continue
        while True:
            try:
                now = client.job(job)
            except wandless.Problem as problem:
                faults.require(False, f"{job} was accepted and is lost: {problem}")
                break
            if now["state"] in wandless.FINAL:
                finals[job] = now
                break
            if time.monotonic() > deadline:
                faults.require(False, f"{job} is still {now['state']}")
                break
            time.sleep(0.05)
    for job, now in finals.items():
        faults.require(now["state"] in ("succeeded", "canceled"), f"{job} is {now['state']}: {now['error']}")
        faults.require(now["attempt"] <= 1, f"{job}: a crash of the service was counted against it")
        if job in ledger.canceled:
            # A cancel answered 202 takes precedence over any outcome; one answered 409 came after the end and is not recorded.
            faults.require(now["state"] == "canceled", f"{job} was answered as canceled and is {now['state']}")
        if now["state"] == "succeeded":
            try:
                for file in client.manifest(job)["files"]:
                    found = client.request("GET", f"/v1/jobs/{job}/artifacts/{file['name']}").body
                    faults.require(sha256(found) == file["sha256"], f"{job}/{file['name']}: wrong bytes")
            except wandless.Problem as problem:
                faults.require(False, f"{job} has no whole result: {problem}")
            folder = os.path.join(service.data, "results", job)
            results = os.listdir(folder) if os.path.isdir(folder) else []
            # A result that was replaced by one with more formats stays until the next start.
            most = 2 if job in ledger.extended else 1
            faults.require(1 <= len(results) <= most, f"{job} has no whole result, or several: {results}")
    deadline = time.monotonic() + 60
    called = ledger.receiver.calls
    while any(job not in called for job in finals) and time.monotonic() < deadline:
        time.sleep(0.1)
    for job, now in finals.items():
        reported = called.get(job, [])
        faults.require(reported and set(reported) == {now["state"]}, f"{job} is {now['state']}, its webhook reported {reported}")
    states = [now["state"] for now in finals.values()]
    print(f"{len(ledger.jobs)} jobs accepted, {states.count('succeeded')} succeeded, {states.count('canceled')} canceled, "
          f"{len(ledger.deleted)} deleted; {sum(map(len, called.values()))} webhooks", flush=True)
    for session in ledger.sessions:
        faults.require(client.request("GET", f"/v1/sessions/{session}").status == 200, f"{session} is lost")
    faults.require(service.metrics()["wandless_jobs_running_without_live_worker"] == 0, "a job runs without a worker")
    code, seconds = service.stop()
    faults.require(code == 0 and seconds < 10, f"the last stop: code {code} after {seconds:.1f} s")
    whole = service.integrity()
    faults.require(whole == "ok", f"integrity check: {whole}")
    verified = subprocess.run([service.program, "verify", service.data], capture_output=True, text=True)
    faults.require(verified.returncode == 0, f"verify: {verified.stdout} {verified.stderr}")


def run(service, faults, seed, n_clients, n_frames, kill):
    """Runs clients while `kill()` kills the service, then checks everything acknowledged."""
    ledger, over = Ledger(), threading.Event()
    service.start()
    clients = [threading.Thread(target=work, args=(service, ledger, 100 * seed + i, over, n_frames)) for i in range(n_clients)]
    for client in clients:
        client.start()
    kill()
    over.set()
    for client in clients:
        client.join()
    check_promises(service, ledger, faults)


def main():
    args = arguments(__doc__, kills=200, points=0, lost=0, clients=4, frames=10, only="")
    dice = random.Random(args.seed)
    faults = Faults()
    service = Service(args.program, words=WORDS)
    if args.kills:
        starts = []

        def kill_at_random():
            for _ in range(args.kills):
                time.sleep(dice.uniform(0.0, 0.6))
                service.kill()
                seconds = service.start()
                faults.require(seconds is not None, "a start was refused")
                starts.append(seconds or service.start())

        run(service, faults, args.seed, args.clients, args.frames, kill_at_random)
        print(f"{args.kills} kills; start to serving: median {sorted(starts)[len(starts) // 2] * 1000:.0f} ms, "
              f"worst {max(starts) * 1000:.0f} ms", flush=True)
    if args.lost:
        deaf = Service(args.program, words=WORDS, environment={"WANDLESS_LOST_ANSWERS": "3"})
        # A lost answer costs its worker 2 s: half of the clients, so that the accepted work ends in time.
        run(deaf, faults, args.seed, (args.clients + 1) // 2, args.frames, lambda: time.sleep(args.lost))
        if faults.found:
            print("data folder kept:", deaf.data)
        else:
            deaf.remove()
    if args.points or args.only:
        reached = [kill_at_point(args, faults, point, hit) for point in points() if args.only in point for hit in passes(point)]
        print(f"{sum(reached)} of {len(reached)} passes of {len(points())} points reached", flush=True)
    faults.end(service, args.keep)


def passes(point):
    """Passes of a point to test: creation, start, recovery and stop happen only once."""
    return (1,) if point.startswith(("create", "start", "recover", "stop")) else (1, 2)


def kill_at_point(args, faults, point, hit):
    """A2 (A3 for the points of recovery): the service is killed at one pass of one failpoint."""
    service = Service(args.program, words=WORDS)
    reached = []

    def kill_there():
        time.sleep(1.0)
        service.kill()
        service.start(WANDLESS_FAILPOINT=f"{point}:{hit}")
        if point.startswith("stop"):
            time.sleep(1.0)
            service.process.send_signal(signal.SIGTERM)
        try:
            service.process.wait(timeout=60)
            reached.append(service.process.returncode == -signal.SIGKILL)
        except subprocess.TimeoutExpired:
            service.kill()
        service.start()

    def kill_creation():
        service.start(WANDLESS_FAILPOINT=f"{point}:{hit}")
        reached.append(service.process.wait(timeout=60) == -signal.SIGKILL)

    n_before = len(faults.found)
    is_creation = point.startswith("create")
    if is_creation:
        kill_creation()
    kill = (lambda: time.sleep(1.0)) if is_creation else kill_there
    run(service, faults, args.seed + sum(map(ord, point)), 2, args.frames, kill)
    faults.require(reached == [True], f"{point}:{hit} was not reached")
    print(f"{point}:{hit}", "reached" if reached == [True] else "NOT REACHED", flush=True)
    if len(faults.found) == n_before:
        service.remove()
    return reached == [True]


if __name__ == "__main__":
    main()
