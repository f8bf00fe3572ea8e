"""B5, B6, row 12: ten thousand queued jobs, a thousand clients while all cores solve, and the duration of a start.

    python3 checks/service/load.py --jobs 10000 --clients 1000 --seconds 60
"""

import http.client
import json
import os
import random
import shutil
import sqlite3
import threading
import time

from harness import Faults, Service, arguments, get, percentile, take


def main():
    args = arguments(__doc__, jobs=10000, clients=1000, seconds=60, requests_per_s=20.0, solver_frames=8000)
    faults = Faults()
    empty = Service(args.program)
    seconds = empty.start()
    ready(empty)
    print(f"start of an empty service {seconds * 1000:.0f} ms")
    faults.require(seconds <= 0.2, "an empty start takes more than 200 ms")
    empty.stop()
    empty.remove()

    service = Service(args.program, words=["--set", f"jobs.concurrent={os.cpu_count()}"])
    service.start()
    client = service.client()
    long = client.upload(take(args.solver_frames, 4, seed=1))["id"]
    short = client.upload(take(10, 2, seed=2))["id"]
    done = client.submit(short, options={"extrinsics": "fixed"})["id"]
    client.wait(done)
    enqueue(service, short, args.jobs, faults)
    solving = [client.submit(long, options={"extrinsics": "refine", "seed": n}, priority=10)["id"] for n in range(20)]
    claims(service, faults)
    lists(service, faults)
    crowd(service, solving, done, args, faults)
    service.kill()
    seconds = service.start()
    seconds += ready(service)
    print(f"start with {args.jobs} jobs {seconds * 1000:.0f} ms")
    faults.require(seconds <= 2.0, "a start with many jobs takes more than 2 s")
    service.kill()
    faults.end(service, args.keep)


def ready(service):
    start = time.monotonic()
    while get(service.port, "/readyz")[0] != 200:
        time.sleep(0.01)
    return time.monotonic() - start


def enqueue(service, session, n_jobs, faults):
    """Fifty clients submit all jobs."""
    body = json.dumps({"session": session, "options": {"extrinsics": "fixed", "exports": []}})
    left = iter(range(n_jobs))
    lock = threading.Lock()
    refused = []

    def submit():
        connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
        while True:
            with lock:
                if next(left, None) is None:
                    return
            connection.request("POST", "/v1/jobs", body=body, headers={"Content-Type": "application/json"})
            answer = connection.getresponse()
            answer.read()
            if answer.status != 202:
                refused.append(answer.status)

    start = time.monotonic()
    threads = [threading.Thread(target=submit) for _ in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    seconds = time.monotonic() - start
    print(f"{n_jobs} jobs accepted in {seconds:.1f} s")
    faults.require(not refused, f"{len(refused)} jobs were refused: {refused[:3]}")
    faults.require(seconds <= 60 * max(1, n_jobs / 10000), "accepting took too long")


CLAIM = """SELECT seq FROM jobs WHERE state = 'queued' AND tenant = 'default' ORDER BY priority DESC, seq LIMIT 1"""
TURN = """SELECT name FROM tenants WHERE n_queued > 0 AND n_running + n_canceling < 10 ORDER BY turn, name LIMIT 1"""


def claims(service, faults):
    """Measures the two statements of a claim on a copy of the database with all jobs queued."""
    copy = service.data + ".copy"
    shutil.copytree(service.data, copy)
    with sqlite3.connect(copy + "/wandless.db") as database:
        times = []
        for _ in range(500):
            start = time.monotonic()
            database.execute(TURN).fetchone()
            database.execute(CLAIM).fetchone()
            times.append(time.monotonic() - start)
        plans = [" ".join(str(row) for row in database.execute("EXPLAIN QUERY PLAN " + sql)) for sql in (CLAIM, TURN)]
    shutil.rmtree(copy)
    print(f"claim p99 {percentile(times, 0.99) * 1000:.2f} ms")
    faults.require(percentile(times, 0.99) <= 0.005, "a claim takes more than 5 ms")
    faults.require("jobs_by_state" in plans[0] and "SCAN" not in plans[0], f"the claim's plan: {plans[0]}")
    faults.require("tenants_waiting" in plans[1] and "TEMP B-TREE" not in plans[1], f"the turn's plan: {plans[1]}")


def lists(service, faults):
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
    times = [get(service.port, "/v1/jobs?page_size=50", connection)[1] for _ in range(200)]
    print(f"list p99 {percentile(times, 0.99) * 1000:.1f} ms")
    faults.require(percentile(times, 0.99) <= 0.05, "a list takes more than 50 ms")


def busy_cores():
    """Busy seconds of all processors together since boot."""
    with open("/proc/stat") as stat:
        return sum(map(int, stat.readline().split()[1:4])) / os.sysconf("SC_CLK_TCK")


def crowd(service, solving, done, args, faults):
    """Requests at a steady rate over many open connections while all cores solve."""
    connections = [http.client.HTTPConnection("127.0.0.1", service.port, timeout=60) for _ in range(args.clients)]
    free = list(range(args.clients))
    lock = threading.Lock()
    times, statuses, broken = [], [], []
    paths = [f"/v1/jobs/{solving[0]}", "/v1/jobs?page_size=20", f"/v1/jobs/{done}/people"]
    end = time.monotonic() + args.seconds

    def request(seed):
        dice = random.Random(seed)
        while time.monotonic() < end:
            with lock:
                which = free.pop(dice.randrange(len(free)))
            try:
                status, seconds = get(service.port, dice.choice(paths), connections[which])
                times.append(seconds)
                statuses.append(status)
            except (http.client.HTTPException, OSError):
                connections[which].close()  # the service had closed the idle connection; the next request reopens it
                broken.append(which)
            with lock:
                free.append(which)
            time.sleep(dice.expovariate(args.requests_per_s / 20))

    client = service.client()
    while client.job(solving[0])["state"] != "running":
        time.sleep(0.1)
    for connection in connections:
        connection.connect()
    worked, begin = busy_cores(), time.monotonic()
    threads = [threading.Thread(target=request, args=(args.seed + i,)) for i in range(20)]
    for thread in threads:
        thread.start()
    peak = 0.0
    while any(thread.is_alive() for thread in threads):
        peak = max(peak, service.rss_mib())
        time.sleep(0.5)
    share = (busy_cores() - worked) / (time.monotonic() - begin) / os.cpu_count()
    states = [client.job(job)["state"] for job in solving]
    state = f"{states.count('succeeded')} done, {states.count('running')} running, cores {100 * share:.0f} % busy"
    faults.require("running" in states and share >= 0.9, f"the cores were not busy to the end: {state}")
    worst = percentile(times, 0.99) * 1000
    print(f"{len(times)} requests of {args.clients} clients, solver {state}: p50 {percentile(times, 0.5) * 1000:.1f} ms, "
          f"p99 {worst:.1f} ms, worst {max(times) * 1000:.0f} ms, RSS {peak:.0f} MiB, {len(broken)} reopened")
    faults.require(all(status < 500 for status in statuses), f"answers: {sorted(set(statuses))}")
    faults.require(worst <= 250, "the status p99 is above 250 ms")
    faults.require(peak <= 300, "the service uses more than 300 MiB")


if __name__ == "__main__":
    main()
