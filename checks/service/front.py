"""The HTTP front: connections without a key, hosts and origins, inspections, keys of the client, and small faults.

    python3 checks/service/front.py --program target/release/wandless [--row 3] [--jobs 20]

Prints one line for each row; exits with 1 if one failed.
"""

import http.client
import json
import os
import resource
import socket
import subprocess
import sys
import threading
import time

from harness import Faults, Service, arguments, percentile, sha256, take, wandless

SHORT = {"extrinsics": "fixed", "exports": []}
# A service that cannot have more than 1024 file descriptors.
FEW_DESCRIPTORS = ["sh", "-c", 'ulimit -n 1024 && exec "$@"', "sh"]


def key(service, *words):
    command = [service.program, "key", "create", "--data", service.data, *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def revoke(service, token):
    subprocess.run([service.program, "key", "revoke", token.split("_")[1], "--data", service.data], check=True)


RUNNING = []


def started(options, words=(), **parts):
    service = Service(options.program, words=words, **parts)
    if service.start() is None:
        raise OSError("the service did not start")
    RUNNING.append(service)
    return service


def ended(service):
    RUNNING.remove(service)
    service.kill()
    service.remove()


def exchange(service, method, path, headers, body=b""):
    """One request with exactly these headers; returns status, headers and body."""
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in {**headers, "Content-Length": str(len(body))}.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, answer.headers, text


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


class Idlers:
    """A client without a key that holds many idle connections, and opens closed ones again."""

    def __init__(self, service, wanted):
        self.service, self.wanted, self.open, self.over = service, wanted, [], threading.Event()
        self.most = 0
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self):
        self.thread.start()
        time.sleep(3.0)
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()
        for connection in self.open:
            connection.close()

    def run(self):
        while not self.over.is_set():
            kept = []
            for connection in self.open:
                if self.is_open(connection):
                    kept.append(connection)
                else:
                    connection.close()
            self.open = kept
            while len(self.open) < self.wanted and not self.over.is_set():
                try:
                    connection = socket.create_connection(("127.0.0.1", self.service.port), timeout=0.5)
                    connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
                    connection.setblocking(False)
                    self.open.append(connection)
                except OSError:
                    break
            self.most = max(self.most, len(self.open))
            self.over.wait(1.0)

    @staticmethod
    def is_open(connection):
        try:
            while connection.recv(65536):
                pass
            return False
        except BlockingIOError:
            return True
        except OSError:
            return False


def descriptors(service):
    return len(os.listdir(f"/proc/{service.process.pid}/fd"))


def row_2(options, require):
    """Idle connections without a key take no descriptor that a job needs; the soft limit is raised."""
    service = started(options, prefix=FEW_DESCRIPTORS)
    client = service.client(key=key(service))
    session = client.upload(take(60, 3, seed=2))["id"]
    most, states = 0, {}
    with Idlers(service, options.connections):
        jobs = [client.submit(session, options={**SHORT, "seed": seed})["id"] for seed in range(options.jobs)]
        deadline = time.monotonic() + 60 + 10 * options.jobs
        while len(states) < len(jobs) and time.monotonic() < deadline:
            most = max(most, descriptors(service))
            for job in jobs:
                found = client.job(job)
                if found["state"] in wandless.FINAL:
                    states[job] = found["state"], found["error"]
            time.sleep(0.2)
    others = [end for end in states.values() if end[0] != "succeeded"]
    require(len(states) == len(jobs) and not others, f"{len(states)} of {len(jobs)} jobs ended, not succeeded: {others[:2]}")
    require(most <= 900, f"{most} of 1024 descriptors are in use")
    ended(service)
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    service = started(options, prefix=["sh", "-c", 'ulimit -Sn 256 && exec "$@"', "sh"])
    with open(f"/proc/{service.process.pid}/limits") as limits:
        soft = next(int(line.split()[3]) for line in limits if line.startswith("Max open files"))
    require(soft >= min(2048, hard), f"the soft limit is {soft}, the hard limit {hard}")
    ended(service)
    return f"{len(jobs)} jobs succeeded beside {options.connections} idle connections, at most {most} of 1024 descriptors; soft limit 256 raised to {soft}"


def row_3(options, require):
    """Idle connections without a key do not lock out a client with a key."""
    service = started(options, prefix=FEW_DESCRIPTORS)
    token = key(service, "--scopes", "read,write,metrics")
    client = service.client(key=token)
    session = client.upload(take(60, 3, seed=3))["id"]
    jobs = [client.submit(session, options={**SHORT, "seed": seed})["id"] for seed in range(options.jobs)]
    waits, failures = [], []
    with Idlers(service, options.connections):
        end = time.monotonic() + 15
        while time.monotonic() < end:
            start = time.monotonic()
            connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=10)
            try:
                connection.request("GET", "/v1/jobs", headers=bearer(token))
                status = connection.getresponse().status
                if status != 200:
                    failures.append(status)
            except OSError as error:
                failures.append(repr(error))
            connection.close()
            waits.append(time.monotonic() - start)
            time.sleep(0.1)
    require(not failures, f"{len(failures)} of {len(waits)} requests with a key failed: {failures[:3]}")
    require(max(waits) <= 5, f"a request with a key took {max(waits):.1f} s")
    # Without reopening: the connections of one address are limited at once, and all are closed soon.
    held = [socket.create_connection(("127.0.0.1", service.port)) for _ in range(300)]
    for connection in held:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
    time.sleep(3.5)
    limited = sum(Idlers.is_open(made_unblocking(connection)) for connection in held)
    time.sleep(5)
    left = sum(Idlers.is_open(connection) for connection in held)
    require(limited <= 140, f"one address keeps {limited} connections without a key")
    require(left == 0, f"{left} idle connections without a key are open after 8 s")
    ends = [client.wait(job)["state"] for job in jobs]
    require(set(ends) == {"succeeded"}, f"the jobs beside them are {ends}")
    ended(service)
    return f"{len(jobs)} jobs succeeded; {len(waits)} requests with a key, the slowest {max(waits):.2f} s, p50 {percentile(waits, 0.5) * 1000:.0f} ms; of 300 idle connections of one address {limited} after 3.5 s, {left} after 8.5 s"


def made_unblocking(connection):
    connection.setblocking(False)
    return connection


def row_6(options, require):
    """Without keys only loopback names and listed hosts are answered (DNS rebinding)."""
    refused = answered = 0
    for words, listed in (((), ()), (("--set", "allowed_hosts=['studio.example']"), ("studio.example",))):
        service = started(options, words=words)
        port = service.port
        for path in ("/v1/webhook-secret", "/v1/jobs", "/v1/sessions", "/metrics"):
            for host in (f"evil.example:{port}", "localhost.evil.example", "127.0.0.1.evil.example", "10.0.0.1"):
                status, _, text = exchange(service, "GET", path, {"Host": host, "Sec-Fetch-Site": "same-origin"})
                require(status == 403 and b"whsec_" not in text, f"GET {path} with the host {host}: {status}")
                refused += status == 403
            for host in (f"127.0.0.1:{port}", "localhost", f"[::1]:{port}", *listed):
                status = exchange(service, "GET", path, {"Host": host})[0]
                require(status == 200, f"GET {path} with the host {host}: {status}")
                answered += status == 200
        if not listed:
            ended(service)
    token = key(service, "--scopes", "read,write")
    status = exchange(service, "GET", "/v1/jobs", {"Host": "any.example", **bearer(token)})[0]
    require(status == 200, f"with a key the host any.example is answered {status}")
    ended(service)
    return f"{refused} requests to foreign hosts refused, {answered} to known ones answered"


def row_7(options, require):
    """Without `Sec-Fetch-Site` the `Origin` must be the service or listed."""
    service = started(options, words=["--set", "cors_origins=['https://studio.example']"])
    host = f"127.0.0.1:{service.port}"
    for origin in ("http://evil.example", "null", f"http://evil.example:{service.port}", "http://127.0.0.1:1"):
        for method, path in (("POST", "/v1/sessions"), ("POST", "/v1/jobs"), ("DELETE", "/v1/jobs/job_0")):
            headers = {"Host": host, "Origin": origin, "Content-Type": "application/json"}
            status = exchange(service, method, path, headers, b"{}")[0]
            require(status == 403, f"{method} {path} by a page of {origin}: {status}")
    for origin in (f"http://{host}", "https://studio.example", None):
        headers = {"Host": host, "Content-Type": "application/json", **({"Origin": origin} if origin else {})}
        status = exchange(service, "POST", "/v1/sessions", headers, b"{}")[0]
        require(400 <= status < 500 and status != 403, f"POST by {origin}: {status}")
    ended(service)
    return "pages of 4 foreign origins refused 12 times; own, listed and absent origins pass"


def row_10(options, require):
    """Inspections are kept by digest, and those of one tenant do not hold up another's upload."""
    service = started(options)
    a, b = (service.client(key=key(service, "--tenant", name)) for name in "ab")
    documents = [take(8000, 4, seed=seed) for seed in range(3)]  # an inspection takes a fraction of a second
    sessions = [a.upload(document)["id"] for document in documents]
    start = time.monotonic()
    b.upload(take(40, 2, seed=100))
    alone = time.monotonic() - start
    times = []

    def inspect(session):
        start = time.monotonic()
        service.client(key=a.key).inspect(session)
        times.append(time.monotonic() - start)

    threads = [threading.Thread(target=inspect, args=(sessions[i % len(sessions)],)) for i in range(40)]
    start = time.monotonic()
    for thread in threads:
        thread.start()
    time.sleep(0.1)
    upload = time.monotonic()
    b.upload(take(40, 2, seed=101))
    upload = time.monotonic() - upload
    for thread in threads:
        thread.join()
    total = time.monotonic() - start
    require(len(times) == 40, f"{len(times)} of 40 inspections were answered")
    require(upload <= max(1.5, 5 * alone), f"an upload beside 40 inspections took {upload:.2f} s, alone {alone:.2f} s")
    path = f"/v1/sessions/{sessions[0]}/inspection"
    first = a.request("GET", path)
    start = time.monotonic()
    again = [a.request("GET", path) for _ in range(10)]
    cached = (time.monotonic() - start) / 10
    tag = first.headers.get("ETag", "")
    require(all(answer.body == first.body for answer in again), "two inspections of one session differ")
    unchanged = a.request("GET", path, headers={"If-None-Match": tag}).status
    require(unchanged == 304, f"If-None-Match is answered {unchanged}")
    require(cached <= 0.05, f"an inspection that was made before takes {cached * 1000:.0f} ms")
    ended(service)
    return f"40 inspections of 3 sessions in {total:.1f} s; upload beside them {upload:.2f} s, alone {alone:.2f} s; repeated {cached * 1000:.1f} ms, 304 by ETag"


def row_12(options, require):
    """The log names tenant, key and job of a request, and never the key itself."""
    service = started(options, words=["--log-format", "json"], environment={"WANDLESS_LOG": "info"})
    token = key(service, "--tenant", "a")
    client = service.client(key=token)
    job = client.submit(client.upload(take(10, 2, seed=12))["id"], options=SHORT)["id"]
    client.delete_job(job)
    service.stop()
    time.sleep(0.2)  # its last lines are read by a thread
    lines = [json.loads(line) for line in service.stderr if line.startswith("{")]
    spans = [line["span"] for line in lines if line.get("span", {}).get("job.id") == job]
    named = [span for span in spans if span.get("tenant") == "a" and span.get("key.id") == token.split("_")[1]]
    require({span.get("method") for span in named} >= {"POST", "DELETE"}, f"the requests for a job are logged as {spans}")
    require(token.rsplit("_", 1)[1] not in "".join(service.stderr), "the key is in the log")
    ended(service)
    return f"{len(named)} requests for a job are logged with tenant and key id"


def row_15(options, require):
    """`submit` sends a key and prints no user information of a URL."""
    service = started(options)
    token = key(service)
    session, chosen = os.path.join(service.data, "take.json"), os.path.join(service.data, "options.json")
    for path, document in ((session, take(10, 2, seed=15)), (chosen, SHORT)):
        with open(path, "w") as file:
            json.dump(document, file)

    def submit(server, *words, **environment):
        command = [options.program, "submit", session, "--options", chosen, "--server", server, *words]
        ran = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "WANDLESS_KEY": "", **environment})
        text = ran.stdout + ran.stderr
        require(token not in text and "pass-word" not in text, f"submit prints a key: {text}")
        return ran.returncode, text

    inside = service.url.replace("http://", f"http://x:{token}@")
    for how, ran in (("--key", submit(service.url, "--key", token)), ("WANDLESS_KEY", submit(service.url, WANDLESS_KEY=token)),
                     ("the URL", submit(inside))):
        require(ran[0] == 0, f"submit with the key in {how}: {ran}")
    for server in (service.url.replace("http://", "http://x:pass-word@"), service.url):
        code, text = submit(server)
        require(code == 1 and "unauthorized" in text, f"submit without a valid key: {code} {text}")
    ended(service)
    return "a key by argument, environment and URL; printed 0 times in 5 runs"


def row_17(options, require):
    """Small faults, each in a function of its own."""
    service = started(options, words=["--set", "tenants.requests_per_s=1000000.0"])  # downloads repeat as fast as they can
    token = key(service)
    client = service.client(key=token)
    figures = [part(service, client, token, options, require) for part in (small_values, headers_and_conditions, secret, stream, ranges, deletions)]
    ended(service)
    return "; ".join(figures)


def small_values(service, client, token, options, require):
    session = client.upload(take(10, 2, seed=17))["id"]
    for priority in (-(1 << 63), (1 << 63) - 1):
        body = json.dumps({"session": session, "options": SHORT, "priority": priority}).encode()
        status = exchange(service, "POST", "/v1/jobs", {**bearer(token), "Content-Type": "application/json"}, body)[0]
        require(status == 400, f"the priority {priority} is answered {status}")
    for setting in ("limits.bad_keys_per_s=-1.0", "tenants.requests_per_s=-5.0", "tenants.max_bytes=-1"):
        command = [options.program, "serve", "--print-settings", "--set", setting]
        code = subprocess.run(command, capture_output=True, timeout=20).returncode
        require(code == 2, f"{setting}: exit code {code}")
    named = {}
    for length in (1000, 4000):
        document = take(10, 2, seed=length)
        name = "x" * length
        document["cameras"][0]["id"] = name
        document["poses"][name] = document["poses"].pop("cam0")
        try:
            session = client.upload(document)["id"]
            job = client.submit(session, options={"extrinsics": "fixed", "exports": ["chan", "colmap", "opencv_yaml"]})["id"]
            named[length] = client.wait(job)["state"]
        except wandless.Problem as problem:
            named[length] = problem.code
        except wandless.JobFailed as failed:
            named[length] = f"{failed.job['state']} after the solve: {failed.job['error']}"
    require(named == {1000: "succeeded", 4000: "camera_id_invalid"}, f"camera ids of 1000 and 4000 bytes: {named}")
    return "extreme priorities, rates and camera ids refused at once"


def headers_and_conditions(service, client, token, options, require):
    paths = ("/", "/docs", "/openapi.json", "/healthz", "/v1/jobs", "/v1/sessions", "/v1/nothing")
    without = [path for path in paths if exchange(service, "GET", path, bearer(token))[1].get("X-Content-Type-Options") != "nosniff"]
    require(not without, f"without nosniff: {without}")
    job = next(job["id"] for job in client.jobs() if job["state"] == "succeeded")
    tag = client.request("GET", f"/v1/jobs/{job}/people").headers["ETag"]
    for method, path in (("GET", f"/v1/jobs/{job}/people"), ("GET", f"/v1/jobs/{job}"), ("DELETE", f"/v1/jobs/{job}")):
        status = exchange(service, method, path, {**bearer(token), "If-Match": '"other"'})[0]
        require(status == 412, f"{method} {path} with another If-Match: {status}")
    status = exchange(service, "GET", f"/v1/jobs/{job}/people", {**bearer(token), "If-Match": tag})[0]
    require(status == 200, f"GET with its own If-Match: {status}")
    return "nosniff everywhere, If-Match honoured"


def secret(service, client, token, options, require):
    reader = key(service, "--scopes", "read")
    status = exchange(service, "GET", "/v1/webhook-secret", bearer(reader))[0]
    require(status == 403, f"a read key that asks for the signing secret: {status}")
    first = client.webhook_secret()
    status, _, text = exchange(service, "POST", "/v1/webhook-secret", bearer(token))
    require(status == 200 and client.webhook_secret() != first, f"rotation of the secret: {status} {text[:80]}")
    return "signing secret for writers only, replaced on request"


def stream(service, client, token, options, require):
    passing = key(service)
    job = client.submit(client.upload(take(20000, 3, seed=18))["id"], options=SHORT)["id"]
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=15)
    connection.request("GET", f"/v1/jobs/{job}/events", headers=bearer(passing))
    answer = connection.getresponse()
    answer.readline()
    revoke(service, passing)
    start = time.monotonic()
    try:
        while answer.readline() and time.monotonic() < start + 15:
            pass
    except OSError:
        pass
    seconds = time.monotonic() - start
    require(seconds <= 5, f"an event stream lasts {seconds:.0f} s after its key was revoked")
    require(client.job(job)["state"] in ("queued", "running"), "the job had ended before the stream could")
    client.delete_job(job)
    return f"event stream ended {seconds:.1f} s after its key"


def large_result(client, seed):
    """A job with a large file: its id, the name of the file and its size."""
    session = client.upload(take(200, 4, seed=19))["id"]
    job = client.submit(session, options={"extrinsics": "fixed", "exports": ["glb"], "seed": seed})["id"]
    client.wait(job)
    file = max(client.manifest(job)["files"], key=lambda file: file["bytes"])
    return job, file["name"], file["bytes"]


def ranges(service, client, token, options, require):
    job, name, size = large_result(client, 0)
    path = f"/v1/jobs/{job}/artifacts/{name}"
    whole = client.artifact(job, name)

    def bytes_read():
        with open(f"/proc/{service.process.pid}/io") as io:
            return int(next(line for line in io if line.startswith("rchar")).split()[1])

    before = bytes_read()
    for at in range(50):
        part = client.request("GET", path, headers={"Range": f"bytes={at}-{at + 9}"})
        require(part.status == 206 and part.body == whole[at:at + 10], f"the range at {at} is wrong")
    read = bytes_read() - before
    require(read <= 5 * size + (4 << 20), f"50 ranges of 10 bytes read {read / size:.0f} times the file of {size} bytes")
    require(sha256(whole) == client.request("GET", path).headers["ETag"].strip('"'), "the ETag is not the digest")
    return f"50 ranges of a file of {size >> 10} KiB read {read >> 10} KiB"


def deletions(service, client, token, options, require):
    """Downloads while their job is deleted."""
    statuses = {}
    for seed in range(1, 4):
        job, name, _ = large_result(client, seed)
        over = threading.Event()

        def download():
            connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=30)
            while not over.is_set():
                connection.request("GET", f"/v1/jobs/{job}/artifacts/{name}", headers=bearer(token))
                answer = connection.getresponse()
                answer.read()
                statuses[answer.status] = statuses.get(answer.status, 0) + 1

        threads = [threading.Thread(target=download) for _ in range(12)]
        for thread in threads:
            thread.start()
        time.sleep(0.5)
        client.delete_job(job)
        time.sleep(0.2)
        over.set()
        for thread in threads:
            thread.join()
    require(set(statuses) <= {200, 404} and 404 in statuses, f"downloads during deletions: {statuses}")
    return f"downloads during deletions {dict(sorted(statuses.items()))}"


def main():
    options = arguments(__doc__, row=0, jobs=4, connections=1000)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(8192, hard), hard))
    failed = False
    for number, check in {2: row_2, 3: row_3, 6: row_6, 7: row_7, 10: row_10, 12: row_12, 15: row_15, 17: row_17}.items():
        if options.row not in (0, number):
            continue
        faults, start = Faults(), time.monotonic()
        figures = ""
        try:
            figures = check(options, lambda truth, fault, number=number: faults.require(truth, f"row {number}: {fault}"))
        except (OSError, http.client.HTTPException, subprocess.SubprocessError, wandless.Problem, wandless.JobFailed) as error:
            faults.require(False, f"row {number}: {error!r}")
        for service in list(RUNNING):
            ended(service)
        seconds = time.monotonic() - start
        failed = failed or bool(faults.found)
        end = f"FAILED: {faults.found[0].split(': ', 1)[1]}" if faults.found else f"held: {figures}"
        print(f"row {number}: {end} ({seconds:.0f} s)", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
