"""Catalogue E1 to E10: isolation of tenants, rotation of keys, webhook targets, quotas, and no leaks in answers and logs.

    python3 checks/service/tenants.py --calls 2000
"""

import http.client
import http.server
import json
import os
import re
import socketserver
import statistics
import subprocess
import threading
import time

from harness import Faults, Service, arguments, take, wandless

INSIDE = ["http://127.0.0.1:9/", "http://[::1]:8080/", "http://0.0.0.0/", "http://169.254.169.254/latest/meta-data", "http://10.0.0.1/",
          "http://172.16.0.1/", "http://192.168.1.1/", "http://[::ffff:127.0.0.1]/", "http://2130706433/", "http://0177.0.0.1/",
          "http://0x7f.1/", "http://localhost:9000/", "file:///etc/passwd", "http://user:pass@example.org/", "http://example.org:22/",
          "gopher://example.org/", "http://[fe80::1]/", "http://100.64.0.1/"]


def key(service, *words):
    made = subprocess.run([service.program, "key", "create", "--data", service.data, *words], capture_output=True, text=True, check=True)
    return made.stdout.strip()


class Callers:
    """Persistent connections, one per key."""

    def __init__(self, service):
        self.service, self.kept = service, {}

    def ask(self, token, method, path, body=None, headers=None):
        connection = self.kept.get(token) or http.client.HTTPConnection("127.0.0.1", self.service.port, timeout=60)
        self.kept[token] = connection
        wanted = {**({"Authorization": f"Bearer {token}"} if token else {}), **(headers or {})}
        if body is not None:
            body, wanted["Content-Type"] = json.dumps(body), "application/json"
        start = time.perf_counter()
        try:
            connection.request(method, path, body=body, headers=wanted)
            answer = connection.getresponse()
            text = answer.read()
        except (http.client.HTTPException, OSError):
            connection.close()
            self.kept.pop(token)
            return self.ask(token, method, path, json.loads(body) if body else None, headers)
        return answer.status, text, {k.lower(): v for k, v in answer.getheaders()}, time.perf_counter() - start


def matrix(service, callers, keys, faults, options):
    """E1, E3: every route of the OpenAPI document as another tenant, with a revoked key, and without a key."""
    a, b = keys["a"], keys["b"]
    client = service.client(key=a)
    session = client.upload(take(10, 2, seed=1))["id"]
    job = client.submit(session, options={"extrinsics": "fixed"}, key="same", webhook="https://example.org/hook")["id"]
    client.wait(job)
    delivery = client.deliveries(job)[0]["id"]
    unknown = {session: "session_" + "0" * 32, job: "job_" + "0" * 32, delivery: "delivery_" + "0" * 32}
    routes = json.loads(callers.ask(None, "GET", "/openapi.json")[1])["paths"]
    n, paths = 0, []
    for path, methods in routes.items():
        for method in methods:
            method = method.upper()
            if path.startswith("/v1"):
                for name, status in (("revoked", 401), (None, 401)):
                    real = path.replace("{id}", job).replace("{name}", "people.json").replace("{delivery}", delivery)
                    found = callers.ask(keys.get(name), method, real)[0]
                    faults.require(found in (status, 429), f"E1: {method} {path} as {name or 'no key'}: {found}")
                    n += 1
            if "{id}" not in path:
                continue
            real = path.replace("{id}", session if "sessions" in path else job).replace("{name}", "people.json").replace("{delivery}", delivery)
            none = real
            for known, other in unknown.items():
                none = none.replace(known, other)
            foreign, missing = callers.ask(b, method, real), callers.ask(b, method, none)
            n += 1
            same = [clean(text, real, none) for _, text, _, _ in (foreign, missing)]
            faults.require(foreign[0] == missing[0] == 404, f"E1: {method} {path}: {foreign[0]} and {missing[0]}")
            faults.require(same[0] == same[1], f"E1: {method} {path}: {same}")
            heads = [{k: v for k, v in head.items() if k not in ("x-request-id", "date", "content-length")} for _, _, head, _ in (foreign, missing)]
            faults.require(heads[0] == heads[1], f"E1: {method} {path}: {heads}")
            if method == "GET" and "events" not in path:
                paths.append((real, none))
    faults.require(client.job(job)["state"] == "succeeded", "E1: another tenant has changed the job")
    other = service.client(key=b)
    faults.require(not list(other.jobs()) and not json.loads(other.request("GET", "/v1/sessions").body)["sessions"], "E1: lists show resources of another tenant")
    status = callers.ask(b, "POST", "/v1/jobs", {"session": session})[0]
    faults.require(status == 404, f"E1: a job on a foreign session: {status}")
    own = other.upload(take(10, 2, seed=1))["id"]
    mine = other.submit(own, options={"extrinsics": "fixed"}, key="same")["id"]
    faults.require(own != session and mine != job, "E1: sessions or idempotency keys are shared between tenants")
    differences = []
    for real, none in paths:
        times = {real: [], none: []}
        for i in range(options.calls // len(paths)):
            for path in ((real, none) if i % 2 else (none, real)):
                times[path].append(callers.ask(b, "GET", path)[3])
        differences.append(abs(statistics.median(times[real]) - statistics.median(times[none])))
    worst = max(differences) * 1000
    # A median needs many calls.
    faults.require(worst < 1.0 or options.calls < 1000, f"E1: medians differ by {worst:.2f} ms")
    faults.require(all(re.fullmatch(r"(job|session|delivery)_[0-9a-f]{32}", i) for i in (session, job, delivery)), "E3: ids")
    print(f"E1: {n} calls are refused alike; {options.calls} timed calls, medians differ by at most {worst:.3f} ms", flush=True)
    return session, job


def clean(text, *paths):
    for path in paths:
        text = text.replace(path.encode(), b"")
    return re.sub(rb"(job|session|delivery)_[0-9a-f]{32}", b"", text)


def mass_assignment(callers, a, session, faults):
    """E2."""
    for field in ("tenant", "state", "fence", "attempt", "id", "crashes"):
        status = callers.ask(a, "POST", "/v1/jobs", {"session": session, field: "x"})[0]
        faults.require(status == 400, f"E2: a job with `{field}`: {status}")
        status = callers.ask(a, "POST", "/v1/jobs", {"session": session, "options": {field: "x"}})[0]
        faults.require(status == 400, f"E2: options with `{field}`: {status}")
    print("E2: unknown members are refused", flush=True)


def rotation(service, callers, faults):
    """E5: two valid keys; a revoked key is refused within a second, and its job continues."""
    old, new = key(service, "--tenant", "r"), key(service, "--tenant", "r")
    client = service.client(key=old)
    job = client.submit(client.upload(take(300, 3, seed=5))["id"], options={"extrinsics": "fixed"})["id"]
    faults.require(service.client(key=new).job(job)["id"] == job, "E5: the second key sees another tenant")
    subprocess.run([service.program, "key", "revoke", old.split("_")[1], "--data", service.data], check=True)
    start = time.monotonic()
    while (status := callers.ask(old, "GET", f"/v1/jobs/{job}")[0]) == 200 and time.monotonic() < start + 5:
        time.sleep(0.01)
    seconds = time.monotonic() - start
    faults.require(status == 401 and seconds <= 1, f"E5: a revoked key is answered {status} after {seconds:.1f} s")
    faults.require(service.client(key=new).wait(job)["state"] == "succeeded", "E5: the job of the revoked key did not continue")
    print(f"E5: refused {seconds * 1000:.0f} ms after it was revoked; the job continued", flush=True)
    return old, new


def webhooks(service, callers, a, session, faults):
    """E7: no private address is called, no redirect followed, an endless answer cut off; an allowed address gets signed calls."""
    for url in INSIDE:
        status, text, _, _ = callers.ask(a, "POST", "/v1/jobs", {"session": session, "webhook": {"url": url}})
        faults.require(status == 422 or status == 400, f"E7: {url}: {status} {text[:80]}")
    calls, inner = [], []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            calls.append((self.path, dict(self.headers), body))
            if self.path == "/redirect":
                self.send_response(307)
                self.send_header("Location", f"http://127.0.0.1:{self.server.server_port}/inner")
                self.end_headers()
            elif self.path == "/endless":
                self.send_response(200)
                self.end_headers()
                try:
                    for _ in range(10_000):
                        self.wfile.write(b"x" * (1 << 20))
                        inner.append(1)
                except OSError:
                    pass
            elif self.path == "/hang":
                time.sleep(30)
            else:
                self.send_response(204)
                self.end_headers()

        def log_message(self, *words):
            pass

    server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
    server.server_port, server.daemon_threads = server.server_address[1], True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    listed = Service(service.program, words=["--set", "webhooks.allowed_networks=['127.0.0.1']", "--set", "webhooks.timeout_s=3", "--set", "webhooks.first_wait_s=1"])
    listed.start()
    client = listed.client()
    own = client.upload(take(10, 2, seed=8))["id"]
    jobs = {path: client.submit(own, options={"extrinsics": "fixed", "exports": [], "seed": i}, webhook=f"http://127.0.0.1:{server.server_port}{path}")["id"]
            for i, path in enumerate(("/fine", "/redirect", "/endless", "/hang"))}
    for job in jobs.values():
        client.wait(job)
    deadline = time.monotonic() + 20
    while not all(client.deliveries(job)[0]["tries"] for job in jobs.values()) and time.monotonic() < deadline:
        time.sleep(0.2)
    deliveries = {path: client.deliveries(job)[0] for path, job in jobs.items()}
    faults.require(deliveries["/fine"]["state"] == "delivered", f"E7: {deliveries['/fine']}")
    faults.require(deliveries["/redirect"]["last_status"] == 307 and not any(path == "/inner" for path, _, _ in calls), f"E7: a redirect: {deliveries['/redirect']}")
    faults.require(deliveries["/hang"]["state"] == "waiting" and deliveries["/hang"]["last_error"], f"E7: {deliveries['/hang']}")
    faults.require(len(inner) <= 64, f"E7: {len(inner)} MiB of an endless answer were read")
    secret = client.webhook_secret()
    fine = next((headers, body) for path, headers, body in calls if path == "/fine")
    faults.require(wandless.check_webhook(secret, *fine) and not wandless.check_webhook(secret, fine[0], fine[1] + b" "), "E7: the signature")
    again = client.redeliver(jobs["/fine"], deliveries["/fine"]["id"])
    faults.require(again["state"] == "waiting", f"E7: {again}")
    listed.kill()
    listed.remove()
    server.shutdown()
    print(f"E7: {len(INSIDE)} addresses refused; a redirect, an endless and a hanging receiver are cut off", flush=True)


def edges(service, callers, a, faults):
    """E8, E10."""
    status, _, head, _ = callers.ask(a, "GET", "/v1/jobs", headers={"Origin": "https://evil.example"})
    faults.require(status == 200 and "access-control-allow-origin" not in head, "E8: CORS is open")
    status, _, _, _ = callers.ask(a, "DELETE", "/v1/jobs/job_0", headers={"Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site"})
    faults.require(status == 403, f"E8: a page of another site: {status}")
    job = next(service.client(key=a).jobs())["id"]
    _, _, head, _ = callers.ask(a, "GET", f"/v1/jobs/{job}/artifacts/people.json")
    faults.require(head.get("x-content-type-options") == "nosniff" and head.get("content-disposition", "").startswith("attachment"), f"E8: {head}")
    for path in (f"/v1/jobs/{job}/artifacts/", f"/v1/jobs/{job}/artifacts/../../wandless.db", f"/v1/jobs/{job}/artifacts/%2e%2e%2fwandless.db"):
        status, text, _, _ = callers.ask(a, "GET", path)
        faults.require(status in (400, 404) and b"people.json" not in text, f"E8: {path}: {status}")
    bare = subprocess.run([service.program, "serve", "--listen", "0.0.0.0:0", "--data", service.data + ".bare"], capture_output=True, text=True, timeout=20)
    faults.require(bare.returncode == 2 and "loopback" in bare.stderr, f"E8: public address without keys: {bare.returncode} {bare.stderr}")
    result = os.path.join(service.data, "results", job)
    people = next(os.path.join(base, name) for base, _, names in os.walk(result) for name in names if name == "people.json")
    os.rename(people, people + ".away")
    status, text, _, _ = callers.ask(a, "GET", f"/v1/jobs/{job}/people")
    os.rename(people + ".away", people)
    faults.require(status == 500 and service.data.encode() not in text and b"corrupt" in text, f"E10: {status} {text[:200]}")
    print("E8, E10: closed to other origins, and to the network without keys; errors contain no paths", flush=True)


def quotas(program, faults):
    """E9: quotas are exact and are released by deletion."""
    service = Service(program, words=["--set", "tenants.max_queued=5", "--set", "jobs.concurrent=1"])
    service.start()
    token = key(service)
    client = service.client(key=token, patience_s=0.0)
    blocker = client.submit(client.upload(take(60, 2, seed=1))["id"], options={"extrinsics": "fixed"}, priority=9)["id"]
    session, n, refusal = client.upload(take(10, 2, seed=2))["id"], 0, None
    while refusal is None and n < 50:
        try:
            client.submit(session, options={"extrinsics": "fixed", "exports": []})
            n += 1
        except wandless.Problem as problem:
            refusal = problem
    queued = sum(job["state"] == "queued" for job in client.jobs())
    faults.require(refusal is not None and refusal.status == 429 and queued <= 5, f"E9: {queued} queued, then {refusal}")
    waiting = [job["id"] for job in client.jobs() if job["state"] == "queued"]
    client.delete_job(waiting[0]) if waiting else None
    faults.require(client.submit(session, options={"extrinsics": "fixed", "exports": []}), "E9: refused after a deletion")
    service.stop()
    service.words += ["--set", "tenants.max_bytes=200000"]
    service.start()
    client = service.client(key=token, patience_s=0.0)
    refusal, seed = None, 100
    while refusal is None and seed < 200:
        try:
            client.upload(take(20, 2, seed=seed))
            seed += 1
        except wandless.Problem as problem:
            refusal = problem
    faults.require(refusal is not None and refusal.status == 507, f"E9: {seed - 100} uploads, then {refusal}")
    for job in list(client.jobs()):
        client.delete_job(job["id"])
    for stored in json.loads(client.request("GET", "/v1/sessions").body)["sessions"]:
        client.delete_session(stored["id"])
    faults.require(client.upload(take(20, 2, seed=300)), "E9: refused after everything was deleted")
    service.kill()
    service.remove()
    print(f"E9: refused at {queued} queued jobs and at {seed - 100} uploads; accepted after deletion", flush=True)


def main():
    options = arguments(__doc__, calls=2000)
    faults = Faults()
    service = Service(options.program, words=["--log-format", "json", "--set", "limits.bad_keys_per_s=100000", "--set", "tenants.requests_per_s=100000"],
                      environment={"WANDLESS_LOG": "debug,hyper=info"})
    service.start()
    keys = {name: key(service, "--tenant", name) for name in ("a", "b", "revoked")}
    subprocess.run([options.program, "key", "revoke", keys["revoked"].split("_")[1], "--data", service.data], check=True)
    callers = Callers(service)
    session, _ = matrix(service, callers, keys, faults, options)
    mass_assignment(callers, keys["a"], session, faults)
    issued = [*keys.values(), *rotation(service, callers, faults)]
    webhooks(service, callers, keys["a"], session, faults)
    edges(service, callers, keys["a"], faults)
    quotas(options.program, faults)
    service.stop()
    time.sleep(0.2)
    text = "".join(service.stderr)
    with open(os.path.join(service.data, "wandless.db"), "rb") as database:
        stored = database.read()
    for token in issued:
        secret = token.rsplit("_", 1)[1]
        faults.require(secret not in text, "E4: a key is in the log")
        faults.require(secret.encode() not in stored, "E4: the secret of a key is in the database")
    faults.require(text.count("\n") > 100, "E4: the log is missing")
    print(f"E4: {len(issued)} keys are neither in {text.count(chr(10))} lines of log nor in the database", flush=True)
    faults.end(service, options.keep)


if __name__ == "__main__":
    main()
