"""Child processes, webhooks, memory limits and logs: each row is one promise, checked by one function.

    python3 checks/service/workers.py --program target/release/wandless [--row 5]

Rows 5 and 11 create memory control groups, which takes root; without them these rows check less and say so.
"""

import contextlib
import ctypes
import http.server
import io
import os
import random
import shutil
import signal
import socketserver
import subprocess
import sys
import tempfile
import threading
import time
import zipfile

from harness import Failed, Service, arguments, json, percentile, require, take, until, wandless

FIXED = {"extrinsics": "fixed", "exports": []}
MIB = 1 << 20


def children(service):
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(service.process.pid)], capture_output=True, text=True)
    return [int(pid) for pid in found.stdout.split()]


def ended(client, job, seconds=120):
    """The job in its final state, whichever it is."""
    until(lambda: client.job(job)["state"] in wandless.FINAL, seconds)
    return client.job(job)


def key(service, tenant):
    made = subprocess.run([service.program, "key", "create", "--tenant", tenant, "--data", service.data], capture_output=True, text=True)
    return next(word for word in made.stdout.split() if word.startswith("wl_"))


class MemoryGroup:
    """A memory control group with a limit, and a group without a limit inside it, in which a service runs."""

    def __init__(self, limit):
        self.outer, self.inner = None, None
        with open("/proc/self/cgroup") as file:
            groups = [line.strip().split(":", 2) for line in file]
        own = next((path for _, controllers, path in groups if "memory" in controllers.split(",")), None)
        base, limit_file = ("/sys/fs/cgroup/memory" + own, "memory.limit_in_bytes") if own is not None else ("/sys/fs/cgroup", "memory.max")
        outer = os.path.join(base, f"wandless-check-{os.getpid()}-{random.randrange(10**6)}")
        try:
            os.makedirs(os.path.join(outer, "inner"))
            self.outer, self.inner = outer, os.path.join(outer, "inner")
            with open(os.path.join(outer, limit_file), "w") as file:
                file.write(str(limit))
        except OSError:
            self.remove()

    def prefix(self):
        """Words before a command that put it into the inner group."""
        return ["sh", "-c", f'echo $$ > {self.inner}/cgroup.procs && exec "$@"', "sh"] if self.inner else []

    def remove(self):
        for folder in (self.inner, self.outer):
            if folder and os.path.isdir(folder):
                until(lambda: not open(os.path.join(folder, "cgroup.procs")).read(), 5)
                os.rmdir(folder)
        self.outer, self.inner = None, None


def crowd(keypoints, seed=0):
    """A zip of a few megabytes with this number of keypoints: each needs 24 bytes of memory once it is read."""
    dice = random.Random(seed)
    people = ",".join(['{"keypoints":[' + ",".join(["[1,1,1]"] * 17) + "]}"] * 100)
    session = take(1, 2, seed=seed)
    n_frames = keypoints // 1700
    session["n_frames"] = n_frames
    poses = session.pop("poses")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("session.json", json.dumps(session))
        archive.writestr("poses/cam1.json", json.dumps(poses["cam1"]))
        with archive.open("poses/cam0.json", "w", force_zip64=True) as member:
            member.write(b'{"frames":[')
            for n in range(n_frames):  # the note keeps the compression below the limit of zip bombs
                note = dice.randbytes(150).hex()
                member.write((("," if n else "") + f'{{"frame":{n},"note":"{note}","people":[{people}]}}').encode())
            member.write(b"]}")
    return out.getvalue()


def upload_zip(client, data):
    return client.json("POST", "/v1/sessions", body=data, media_type="application/zip")


def peak_mib(service):
    with open(f"/proc/{service.process.pid}/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))


def row_5(args):
    """An upload that needs more than a gigabyte, in a control group of 1 GiB with 20 jobs in flight."""
    hostile = crowd(40_000_000)
    group = MemoryGroup(1 << 30)
    service = Service(args.program, prefix=group.prefix(), words=["--set", "jobs.concurrent=2"])
    try:
        require(service.start() is not None, "the service does not start")
        client = service.client(patience_s=0.0)
        jobs = [client.submit(client.upload(take(60, 4, seed=n))["id"], options=FIXED)["id"] for n in range(20)]
        before = service.rss_mib()
        start = time.monotonic()
        try:
            upload_zip(client, hostile)
            answer = "201"
        except wandless.Problem as problem:
            answer = f"{problem.status} {problem.code}"
            named = "validation_memory_bytes" in problem.remedy
        except OSError as error:
            answer = f"no answer: {error}"
        seconds = time.monotonic() - start
        require(service.process.poll() is None, f"{answer}: the service has ended")
        grown = peak_mib(service) - before
        require(grown <= 64, f"{answer}: the service grew by {grown:.0f} MiB")
        if group.outer:
            require(answer == "413 too_large" and named, f"the upload was answered {answer}")
        patient = service.client()
        states = [ended(patient, job)["state"] for job in jobs]
        require(states.count("succeeded") == 20, f"{answer}: jobs ended {sorted(set(states))}")
        times = []
        for n in range(20):
            start = time.monotonic()
            patient.upload(take(10, 2, seed=100 + n))
            times.append(time.monotonic() - start)
        large = upload_zip(patient, crowd(2_000_000, seed=2))
        patient.inspect(large["id"])
        inspected = peak_mib(service) - before
        require(inspected <= 64, f"an inspection grew the service by {inspected:.0f} MiB")
        note = "" if group.outer else "; SKIPPED the control group: no permission"
        return (f"{len(hostile) / 1e6:.1f} MB answered {answer} after {seconds:.1f} s, service +{grown:.0f} MiB (+{inspected:.0f} MiB with an inspection), 20 of 20 jobs succeeded, "
                f"small upload {percentile(times, 0.5) * 1000:.0f} ms{note}")
    finally:
        service.kill()
        group.remove()
        service.remove()


class Receivers:
    """Webhook receivers: paths below `/hang` do not answer, others note the time of the call."""

    def __init__(self, address):
        calls = self.calls = {}

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                self.rfile.read(int(self.headers["Content-Length"]))
                calls.setdefault(self.path, time.monotonic())
                if self.path.startswith("/hang"):
                    time.sleep(120)
                self.send_response(204)
                self.end_headers()

            def log_message(self, *words):
                pass

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads, request_queue_size = True, 128

        self.server = Server((address, 0), Handler)
        self.url = f"http://{address}:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


def row_9(args):
    """Sixty receivers of one tenant hang; the calls of another tenant are not delayed."""
    timeout_s = 4
    service = Service(args.program, words=["--set", "webhooks.allowed_networks=['127.0.0.0/8']", "--set", f"webhooks.timeout_s={timeout_s}"])
    hanging, other = Receivers("127.0.0.1"), Receivers("127.0.0.2")
    try:
        service.start()
        client = {name: service.client(key=key(service, name)) for name in ("blocker", "a", "b")}
        blocker = client["blocker"].upload(take(4000, 4, seed=1))["id"]
        client["blocker"].submit(blocker, options={"extrinsics": "refine"})
        session = {name: client[name].upload(take(10, 2, seed=2))["id"] for name in ("a", "b")}

        def call(name, url, n):
            """A webhook that is due now: its job is canceled while it waits."""
            job = client[name].submit(session[name], options={**FIXED, "seed": n}, webhook=url)["id"]
            client[name].cancel(job)
            return time.monotonic()

        for n in range(60):
            call("a", f"{hanging.url}/hang/{n}", n)
        time.sleep(1.5)
        delays = {}
        for path, receivers, limit in (("/elsewhere", other, 3.0), ("/same-host", hanging, timeout_s + 3.0)):
            start = call("b", receivers.url + path, len(path))
            until(lambda: path in receivers.calls, 40)
            delays[path] = receivers.calls.get(path, float("inf")) - start
            require(delays[path] <= limit, f"60 hanging receivers of one tenant delay another's call{path} by {delays[path]:.1f} s")
        return f"behind 60 hanging receivers another tenant's call waits {delays['/elsewhere']:.1f} s, to the same host {delays['/same-host']:.1f} s"
    finally:
        service.kill()
        service.remove()


def address_spaces(service):
    """The limits of the children that have one so far, bytes."""
    found = []
    for pid in children(service):
        with contextlib.suppress(OSError), open(f"/proc/{pid}/limits") as limits:
            found += [line.split()[3] for line in limits if line.startswith("Max address space")]
    return [int(limit) for limit in found if limit != "unlimited"]


def row_11(args):
    """The limit of the group around the service's group binds the jobs, and a job over it fails with its figure."""
    limit = 300 * MIB
    service = Service(args.program)
    group = None
    try:
        service.start()
        large = upload_zip(service.client(), crowd(15_000_000))["id"]
        long = service.client().upload(take(4000, 4, seed=1))["id"]
        service.stop()
        group = MemoryGroup(limit)
        if not group.outer:
            return "SKIPPED: no permission to create a control group"
        service.prefix = group.prefix()
        found = []
        for words, expected in (([], limit * 3 // 4), (["--set", f"jobs.memory_bytes={8 << 30}"], limit)):
            service.words = words
            require(service.start() is not None, "the service does not start in the group")
            client = service.client()
            if not words:
                job = client.submit(long, options=FIXED)["id"]
                limits = []  # the job may end within a moment
                until(lambda: limits.extend(address_spaces(service)) or limits, 30, pause=0.001)
                require(limits, "the job has no limit")
                bytes_ = limits[0]
                require(bytes_ <= expected, f"a job may use {bytes_ / MIB:.0f} MiB in a group of {limit // MIB} MiB")
                client.delete_job(job)
            job = ended(client, client.submit(large, options=FIXED)["id"])
            error = job["error"] or {}
            require(job["state"] == "failed" and error.get("code") == "out_of_memory" and f"{expected // MIB} MiB" in error.get("detail", ""),
                    f"a job over the limit is {job['state']}: {error.get('code')} {error.get('detail')}")
            found.append(error["detail"])
            service.stop()
        return f"in a group of {limit // MIB} MiB inside another: {found}"
    finally:
        service.kill()
        if group:
            group.remove()
        service.remove()


def lines_of(service):
    time.sleep(0.3)
    return "".join(service.stderr).splitlines()


def row_12(args):
    """The log says why a job failed, whose it is and which request submitted it; the child's lines are plain."""
    service = Service(args.program, environment={"WANDLESS_LOG": "info"}, words=["--log-format", "json", "--set", "jobs.memory_bytes=90000000"])
    try:
        service.start()
        token = key(service, "studio")
        client = service.client(key=token)
        session = client.upload(take(2000, 4, seed=1))["id"]
        request = {"session": session, "options": FIXED}
        answer = client.request("POST", "/v1/jobs", body=json.dumps(request).encode(), media_type="application/json", headers={"X-Request-Id": "take-7"})
        job = json.loads(answer.body)["id"]
        require(ended(client, job)["state"] == "failed", "the job did not fail")
        lines = [json.loads(line) for line in lines_of(service)]
        ends = [line for line in lines if line.get("message") == "job ended"]
        require(ends, "no line says that the job has ended")
        end = {**ends[-1].get("span", {}), **ends[-1]}
        wanted = {"state": "failed", "code": "out_of_memory", "job.id": job, "tenant": "studio", "key.id": token.split("_")[1], "request.id": "take-7"}
        missing = {name: end.get(name) for name, value in wanted.items() if end.get(name) != value}
        require(not missing and "85 MiB" in end.get("detail", ""), f"the line of a failed job has {missing}: {end}")
        service.stop()

        service.words = []
        service.start()
        client = service.client(key=token)
        job = client.submit(client.upload(take(4000, 4, seed=2))["id"], options={"extrinsics": "refine", "exports": []})["id"]
        checkpoints = os.path.join(service.data, "checkpoints", job)
        require(until(lambda: os.path.isdir(checkpoints) and any(name.endswith(".ckpt") for name in os.listdir(checkpoints)), 60), "no stage has ended")
        service.kill()
        service.start()
        client = service.client(key=token)
        require(until(lambda: any("resumed from its checkpoint" in line for line in service.stderr), 30), "the child's line is not in the log")
        os.kill(children(service)[0], signal.SIGKILL)
        require(until(lambda: any("signal" in line for line in service.stderr), 10), "no line names the signal that ended the child")
        lines = lines_of(service)
        resumed = next(line for line in lines if "resumed from its checkpoint" in line)
        require(" INFO " in resumed and "WARN" not in resumed and job in resumed, f"the child's INFO line appears as: {resumed}")
        require(not any("\x1b" in line or "\\x1b" in line for line in lines), f"colour codes in the log: {resumed!r}")
        crash = next(line for line in lines if "signal" in line)
        require("signal=9" in crash and job in crash and "studio" in crash, f"the line of a killed child: {crash}")
        return f"code, detail, signal, tenant, key, request and job in the log; the child's lines plain, at their level ({len(lines)} lines read)"
    finally:
        service.kill()
        service.remove()


def landlock_version():
    """The version of landlock in this kernel; 0 without it."""
    return max(0, ctypes.CDLL(None).syscall(444, None, 0, 1))


def row_19(args):
    """A child is confined: no system calls for connections, and no file outside of its folders even through a link."""
    place = tempfile.mkdtemp(prefix="wandless-outside-")
    outside = os.path.join(place, "victim")
    with open(outside, "w") as file:
        file.write("untouched")
    service = Service(args.program)
    try:
        service.start()
        client = service.client()
        job = client.submit(client.upload(take(1500, 4, seed=1))["id"], options={"extrinsics": "refine", "exports": []})["id"]
        results = os.path.join(service.data, "results", job)
        require(until(lambda: os.path.isdir(results) and os.listdir(results) and children(service), 30), "the job did not start")
        staging = os.path.join(results, os.listdir(results)[0])
        os.symlink(outside, os.path.join(staging, "cameras.json"))
        require(until(lambda: "Seccomp:\t2" in status_of(children(service)), 5), "the system calls of a child are not restricted")
        end = ended(client, job)
        note = ""
        if landlock_version():
            with open(outside) as file:
                require(file.read() == "untouched", "a child wrote a file outside of its folders, through a link")
            require(end["state"] == "failed", f"the job that met a link is {end['state']}")
        else:
            note = "; SKIPPED files: this kernel has no landlock"
        again = client.submit(client.upload(take(20, 3, seed=2))["id"], options={"exports": ["glb", "colmap", "smpl_npz"]})["id"]
        require(ended(client, again)["state"] == "succeeded", f"a confined job is {client.job(again)['state']}: {client.job(again)['error']}")
        root = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
        texts = {name: open(os.path.join(root, name)).read() for name in ("docker/compose.yaml", "docker/wandless.service", ".ci/run")}
        for name, words in (("docker/compose.yaml", ("mem_limit:", "pids_limit:")), ("docker/wandless.service", ("OOMPolicy=continue", "TasksMax=")),
                            (".ci/run", ("check advisories",))):
            require(all(word in texts[name] for word in words), f"{name} lacks one of {words}")
        return f"a child has a filter of system calls and cannot follow a link out of its folder; limits in compose{note}"
    finally:
        service.kill()
        service.remove()
        shutil.rmtree(place)


def status_of(pids):
    texts = []
    for pid in pids:
        try:
            with open(f"/proc/{pid}/status") as file:
                texts.append(file.read())
        except OSError:
            pass  # it has ended
    return "".join(texts)


ROWS = {5: row_5, 9: row_9, 11: row_11, 12: row_12, 19: row_19}


def main():
    args = arguments(__doc__, row=0)
    has_failed = False
    for row, check in ROWS.items():
        if args.row in (0, row):
            try:
                print(f"row {row}: held: {check(args)}", flush=True)
            except Exception as error:  # a failed request is a finding, too
                has_failed = True
                print(f"row {row}: FAILED: {error if isinstance(error, Failed) else repr(error)}", flush=True)
    sys.exit(has_failed)


if __name__ == "__main__":
    main()
