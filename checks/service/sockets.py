"""Catalogue C1, C4 to C7, E6: slow clients, concurrent use of one idempotency key, malformed HTTP, ranges, disconnecting
clients, guessed keys.

    python3 checks/service/sockets.py --slow 500 --seconds 120
"""

import http.client
import json
import random
import resource
import socket
import subprocess
import threading
import time

from harness import Faults, Service, arguments, get, percentile, take, wandless

HEAD = b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\nContent-Length: 1000000\r\n\r\n"


def slow_clients(service, options, faults):
    """C1: a silent client, a head byte by byte, a body byte by byte, a client that does not read: all are closed, and other
    clients get prompt answers."""
    client = service.client()
    job = client.submit(client.upload(take(300, 4, seed=1))["id"], options={"extrinsics": "fixed", "exports": ["glb"]})["id"]
    client.wait(job)
    large = max(client.manifest(job)["files"], key=lambda file: file["bytes"])["name"]
    kinds = {"silent": b"", "head": b"GET /healthz HTTP/1.1\r\nX: ", "body": HEAD,
             "reader": (f"GET /v1/jobs/{job}/artifacts/{large} HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20).encode()}
    sockets = {}
    for kind, first in kinds.items():
        for _ in range(options.slow):
            connection = socket.socket()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(("127.0.0.1", service.port))
            connection.sendall(first)
            connection.setblocking(False)
            sockets[connection] = kind
    start, times = time.monotonic(), []
    closed = {kind: [] for kind in kinds}
    while sockets and time.monotonic() < start + options.seconds:
        times.append(get(service.port, "/healthz")[1])
        for connection, kind in list(sockets.items()):
            try:
                if kind in ("head", "body"):
                    connection.send(b"x")
                if kind != "reader" and not received(connection):
                    raise ConnectionError
            except (ConnectionError, OSError):
                closed[kind].append(time.monotonic() - start)
                connection.close()
                del sockets[connection]
        time.sleep(1.0)
    # A client that does not read cannot notice the closed connection; the metric of the service shows it.
    opened = service.metrics()["wandless_connections"]
    faults.require(opened <= 3, f"C1: {opened:.0f} connections are open after {options.seconds} s")
    for kind, ends in closed.items():
        if kind == "reader":
            continue
        left = sum(1 for other in sockets.values() if other == kind)
        faults.require(left == 0, f"C1: {left} of kind {kind} are still open after {options.seconds} s")
        print(f"C1 {kind}: {len(ends)} closed, the last after {max(ends, default=0):.0f} s")
    worst = percentile(times, 0.99) * 1000
    faults.require(worst <= 500, f"C1: a normal client waits {worst:.0f} ms")
    print(f"C1: a normal client's p99 {worst:.0f} ms, {opened:.0f} connections remain")


def received(connection):
    """The data received on a non-blocking socket; empty at its end."""
    try:
        return connection.recv(65536)
    except BlockingIOError:
        return b"nothing yet"


def one_key(service, options, faults):
    """C4."""
    client = service.client()
    session = client.upload(take(10, 2, seed=2))["id"]
    answers = []

    def submit():
        answers.append(service.client().submit(session, options={"extrinsics": "fixed"}, key="fifty")["id"])

    threads = [threading.Thread(target=submit) for _ in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    faults.require(len(answers) == 50 and len(set(answers)) == 1, f"C4: {len(set(answers))} jobs of one key")
    try:
        client.submit(session, options={"extrinsics": "fixed", "seed": 1}, key="fifty")
        faults.require(False, "C4: another request under the key was accepted")
    except wandless.Problem as problem:
        faults.require(problem.status == 422, f"C4: {problem}")
    # The answer is lost: the connection is closed after the request.
    body = json.dumps({"session": session, "options": {"extrinsics": "fixed", "seed": 2}}).encode()
    cut = socket.create_connection(("127.0.0.1", service.port))
    cut.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nIdempotency-Key: cut\r\nContent-Type: application/json\r\n"
                b"Content-Length: %d\r\n\r\n" % len(body) + body)
    time.sleep(0.5)
    cut.close()
    connection = http.client.HTTPConnection("127.0.0.1", service.port)
    ids = set()
    for _ in range(2):
        connection.request("POST", "/v1/jobs", body, {"Content-Type": "application/json", "Idempotency-Key": "cut"})
        ids.add(json.loads(connection.getresponse().read())["id"])
    listed = [job for job in client.jobs() if job["options"]["seed"] == 2]
    faults.require(len(ids) == 1 and len(listed) == 1, f"C4: {len(listed)} jobs after a lost answer")
    print("C4: 50 concurrent requests and a lost answer give one job each")


def malformed_http(service, options, faults):
    """C5."""
    before = service.rss_mib()
    get_ = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
    corpus = {
        "CL and TE": b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /x",
        "two lengths": b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello!",
        "signed length": b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: +5\r\n\r\nhello",
        "bare LF": b"GET /healthz HTTP/1.1\nHost: x\n\n",
        "odd TE": b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
        "10,000 headers": get_ + b"X: y\r\n" * 10_000 + b"\r\n",
        "1 MiB header": get_ + b"X: " + b"y" * (1 << 20) + b"\r\n\r\n",
        "64 KiB URL": b"GET /" + b"a" * 65536 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "huge chunk": b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
        "chunk extensions": b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\nTransfer-Encoding: chunked\r\n\r\n1;" + b"a=b;" * 100_000 + b"\r\nx\r\n0\r\n\r\n",
        "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        "no version": b"GET /\r\n\r\n",
        "NUL": b"GET /\0 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "CONNECT": b"CONNECT example.org:443 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "absolute": b"GET http://elsewhere.example/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "traversal": b"GET /v1/jobs/../../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "percent": b"GET /v1/jobs/%ff%fe%00 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "pipelined": (get_ + b"\r\n") * 999 + get_ + b"Connection: close\r\n\r\n",
    }
    rng = random.Random(options.seed)
    for n in range(200):
        corpus[f"noise {n}"] = rng.randbytes(rng.randrange(1, 2000))
    for name, text in corpus.items():
        answer = exchange(service.port, text, half_close=name != "pipelined")
        status = answer[9:12]
        fine = status[:1] == b"4" or not answer or (name in ("pipelined", "absolute", "bare LF") and status == b"200")
        faults.require(fine, f"C5 {name}: {answer[:60]}")
        faults.require(b"root:" not in answer, f"C5 {name}: a file was disclosed")
        if name == "pipelined":
            faults.require(answer.count(b"HTTP/1.1 200") == 1000, "C5: not every pipelined request was answered")
    expect = b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Type: application/zip\r\nContent-Length: 99999999999\r\n\r\n"
    faults.require(exchange(service.port, expect).startswith(b"HTTP/1.1 413"), "C5: 100-continue for what is too large")
    grown = service.rss_mib() - before
    faults.require(get(service.port, "/healthz")[0] == 200 and grown < 64, f"C5: RSS grew by {grown:.0f} MiB")
    print(f"C5: {len(corpus) + 1} malformed requests, RSS +{grown:.0f} MiB")


def exchange(port, text, seconds=8.0, half_close=True):
    connection = socket.create_connection(("127.0.0.1", port))
    connection.settimeout(seconds)
    answer = b""
    try:
        connection.sendall(text)
        if half_close:
            connection.shutdown(socket.SHUT_WR)
        while chunk := connection.recv(65536):
            answer += chunk
    except OSError:
        pass
    connection.close()
    return answer


def ranges(service, options, faults):
    """C6."""
    client = service.client()
    job = client.submit(client.upload(take(60, 3, seed=3))["id"], options={"extrinsics": "fixed"})["id"]
    client.wait(job)
    rng = random.Random(options.seed)
    path = f"/v1/jobs/{job}/people"
    whole = client.request("GET", path)
    size, tag = len(whole.body), whole.headers["ETag"]
    for _ in range(100):
        first = rng.randrange(size)
        last = rng.randrange(first, size + 5)
        part = client.request("GET", path, headers={"Range": f"bytes={first}-{last}", "If-Range": tag})
        faults.require(part.status == 206 and part.body == whole.body[first:last + 1], f"C6: {first}-{last}")
        expected = f"bytes {first}-{min(last, size - 1)}/{size}"
        faults.require(part.headers["Content-Range"] == expected, f"C6: {part.headers['Content-Range']}, not {expected}")
    faults.require(client.request("GET", path, headers={"If-None-Match": tag}).status == 304, "C6: If-None-Match")
    print("C6: 100 ranges are right")


def disconnects(service, options, faults):
    """C7: clients that disconnect during a wait or an event stream."""
    client = service.client()
    job = client.submit(client.upload(take(20000, 3, seed=4))["id"], options={"extrinsics": "fixed"})["id"]
    tag = client.request("GET", f"/v1/jobs/{job}").headers["ETag"]
    for n in range(500):
        path = [f"/v1/jobs/{job}?wait=60", f"/v1/jobs/{job}/events"][n % 2]
        gone = socket.create_connection(("127.0.0.1", service.port))
        gone.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: {tag}\r\n\r\n".encode())
        if n % 50 == 0:
            time.sleep(0.05)
        gone.close()
    deadline = time.monotonic() + 5
    while (held := service.metrics()["wandless_held_answers"]) > 0 and time.monotonic() < deadline:
        time.sleep(0.1)
    faults.require(held == 0, f"C7: {held:.0f} answers are still held after 5 s")
    client.delete_job(job)
    print("C7: 500 clients disconnected, no answer is held")


def guesses(service, options, faults):
    """E6: from here on keys are required."""
    made = subprocess.run([options.program, "key", "create", "--data", service.data], capture_output=True, text=True)
    key = made.stdout.strip()
    statuses, times, over = {}, [], threading.Event()

    def guess():
        connection = http.client.HTTPConnection("127.0.0.1", service.port)
        while not over.is_set():
            status, _ = get(service.port, "/v1/jobs", connection, {"Authorization": "Bearer wl_0000_" + "0" * 64})
            statuses[status] = statuses.get(status, 0) + 1

    threads = [threading.Thread(target=guess) for _ in range(4)]
    for thread in threads:
        thread.start()
    end = time.monotonic() + 5
    while time.monotonic() < end:
        status, seconds = get(service.port, "/v1/jobs", headers={"Authorization": f"Bearer {key}"})
        faults.require(status == 200, f"E6: a valid key is answered {status}")
        times.append(seconds)
        time.sleep(0.05)
    over.set()
    for thread in threads:
        thread.join()
    faults.require(set(statuses) <= {401, 429} and statuses.get(401, 0) <= 120, f"E6: {statuses}")
    print(f"E6: {statuses}, a valid key's p99 {percentile(times, 0.99) * 1000:.0f} ms")


def main():
    options = arguments(__doc__, slow=500, seconds=120, only="")
    faults = Faults()
    # Four kinds at once: the limit of connections is not under test here.
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(8192, resource.getrlimit(resource.RLIMIT_NOFILE)[1]),) * 2)
    service = Service(options.program, words=["--set", f"limits.max_connections={max(1024, 5 * options.slow)}"])
    service.start()
    for check in (one_key, malformed_http, ranges, disconnects, slow_clients, guesses):
        if options.only in check.__name__:
            check(service, options, faults)
    service.kill()
    faults.end(service, options.keep)


if __name__ == "__main__":
    main()
