"""A9 to A12, B1, B2, B4, row 10: orderly stops, jobs that crash, a paused worker, a second service, a full disk, a locked
database, clock changes, and cancels in every stage.

    python3 checks/service/stops.py --stops 50 --cancels 40

The full disk needs permission to mount a tmpfs, the clock changes need `faketime`; without them these checks are skipped
with a message. `--only NAME` runs one check.
"""

import os
import random
import shutil
import signal
import socket
import sqlite3
import subprocess
import tempfile
import threading
import time

from harness import Faults, Service, arguments, faketime_library, take, until, wandless

LONG = 4000


def children(service):
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(service.process.pid)], capture_output=True, text=True)
    return [int(pid) for pid in found.stdout.split()]


def running_job(service, client, seed, frames=LONG):
    job = client.submit(client.upload(take(frames, 4, seed=seed))["id"], options={"extrinsics": "fixed"})["id"]
    until(lambda: client.job(job)["state"] == "running" and children(service), 30)
    return job


def stops(args, faults):
    """A10: orderly stops while a job runs and clients are connected."""
    dice = random.Random(args.seed)
    service = Service(args.program)
    service.start()
    job = running_job(service, service.client(), 1, frames=LONG * max(1, min(30, args.stops // 2)))
    times = []
    for _ in range(args.stops):
        until(lambda: children(service), 10)
        sockets = [socket.create_connection(("127.0.0.1", service.port)) for _ in range(50)]
        for slow in sockets[:10]:
            slow.sendall(b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\nContent-Length: 99\r\n\r\nP")
        time.sleep(dice.uniform(0.0, 0.2))
        code, seconds = service.stop()
        times.append(seconds)
        faults.require(code == 0 and seconds <= 10, f"a stop ended with {code} after {seconds:.1f} s")
        for connection in sockets:
            connection.close()
        service.start()
    faults.require(service.client().job(job)["attempt"] == 1, "a stop was counted against the job")
    print(f"A10: {args.stops} stops, worst {max(times):.1f} s")
    service.kill()
    service.remove()


STEPS = ["queued", "running", "cameras", "denoising", "held_out_check", "joint_trajectories", "metric_scale", "body_fit"]


def has_reached(job, step):
    """Whether a job has reached the step at which to cancel it, or is past it."""
    if step in ("queued", "running"):
        return job["state"] != "queued" or step == "queued"
    stage = job["progress"]["stage"]
    return job["state"] in wandless.FINAL or (stage in STEPS and STEPS.index(stage) >= STEPS.index(step))


def cancels(args, faults):
    """Row 10: cancels at every step of a job."""
    dice = random.Random(args.seed)
    service = Service(args.program)
    service.start()
    client = service.client()
    session = client.upload(take(6000, 4, seed=3))["id"]
    times, states, too_late = [], {}, 0
    for n in range(args.cancels):
        step = STEPS[n % len(STEPS)]
        blocker = client.submit(session, options={"extrinsics": "refine"}, priority=5)["id"] if step == "queued" else None
        job = client.submit(session, options={"extrinsics": "refine"})["id"]
        begin = time.monotonic()
        while not has_reached(client.job(job), step) and time.monotonic() < begin + 60:
            time.sleep(0.002)
        time.sleep(dice.choice([0.0, 0.0, 0.05]))
        if blocker:
            faults.require(client.job(blocker)["state"] == "running", "no other job was running before the queued job")
        before = client.job(job)
        stage = before["progress"]["stage"] or before["state"]
        start = time.monotonic()
        try:
            client.cancel(job)
        except wandless.Problem as problem:
            too_late += problem.code == "already_final"
            continue
        expected = children(service) if blocker else []
        done = until(lambda: client.job(job)["state"] == "canceled" and children(service) in ([], expected), 5)
        seconds = time.monotonic() - start
        times.append(seconds)
        states[stage] = states.get(stage, 0) + 1
        faults.require(done and seconds <= 2, f"a cancel in {stage} took {seconds:.1f} s")
        faults.require(client.cancel(job)["state"] == "canceled", "a second cancel has a different answer")
        if blocker:
            client.cancel(blocker)
            until(lambda: not children(service), 5)
    last = client.submit(client.upload(take(10, 2, seed=4))["id"], options={"extrinsics": "fixed"})["id"]
    client.wait(last)
    try:
        client.cancel(last)
        faults.require(False, "a job that has succeeded was canceled")
    except wandless.Problem as problem:
        faults.require(problem.status == 409 and problem.code == "already_final", f"{problem}")
    wanted = min(6, args.cancels // 2)  # a step may pass before the cancel arrives
    faults.require(len(states) >= wanted, f"cancels happened only in {states}, not in {wanted} stages")
    print(f"cancel: {len(times)} cancels, {too_late} too late, worst {max(times):.2f} s, in {states}")
    service.kill()
    service.remove()


def poison(args, faults):
    """A9: a job whose process is killed, hangs and aborts is given up as `dead`; other jobs continue."""
    service = Service(args.program, words=["--set", "jobs.silence_limit_s=2"])
    service.start()
    client = service.client()
    job = running_job(service, client, 4)
    other = client.submit(client.upload(take(10, 2, seed=5))["id"], options={"extrinsics": "fixed"})["id"]
    for how in (signal.SIGKILL, signal.SIGSTOP, signal.SIGABRT):
        until(lambda: len(children(service)) == 1, 20)
        child = children(service)[0]
        os.kill(child, how)
        until(lambda: child not in children(service), 10)
    dead = until(lambda: client.job(job)["state"] == "dead", 20)
    faults.require(dead, f"A9: the crashing job is {client.job(job)['state']}")
    faults.require(client.wait(other)["state"] == "succeeded", "A9: the other job did not finish")
    service.kill()
    service.remove()
    print("A9: dead after three crashes (killed, hung, aborted)")


def paused(args, faults):
    """A11, A12: a paused process is killed and its job runs again, with one result; a second service is rejected."""
    service = Service(args.program, words=["--set", "jobs.silence_limit_s=2"])
    service.start()
    client = service.client()
    job = running_job(service, client, 6)
    child = children(service)[0]
    os.kill(child, signal.SIGSTOP)
    gone = until(lambda: child not in children(service), 10)
    if not gone:
        os.kill(child, signal.SIGCONT)
    done = client.wait(job)
    results = os.listdir(os.path.join(service.data, "results", job))
    faults.require(gone and done["attempt"] == 2 and len(results) == 1, f"A11: {gone} {done['attempt']} {results}")
    print("A11: the paused process was killed, the second attempt succeeded, one result")
    start = time.monotonic()
    second = Service(args.program, data=service.data)
    rejected = second.start() is None
    seconds = time.monotonic() - start
    faults.require(rejected and seconds < 1 and "another wandless service" in "".join(second.stderr), "A12: not rejected")
    print(f"A12: the second service was rejected after {seconds:.2f} s")
    service.kill()
    service.remove()


def held(args, faults):
    """B2: another process locks the database for 1 s and for 30 s."""
    service = Service(args.program)
    service.start()
    client = service.client(patience_s=0.0)
    session = client.upload(take(10, 2, seed=7))["id"]
    holder = sqlite3.connect(os.path.join(service.data, "wandless.db"), isolation_level=None, check_same_thread=False)
    for seconds in (1, 30):
        holder.execute("BEGIN IMMEDIATE")
        threading.Timer(seconds, lambda: holder.execute("ROLLBACK")).start()
        start = time.monotonic()
        try:
            client.submit(session, key=f"held-{seconds}")
            problem_found = None
        except wandless.Problem as problem:
            problem_found = problem
        waited = time.monotonic() - start
        if seconds == 1:
            faults.require(problem_found is None, f"B2: a request was rejected during a lock of one second: {problem_found}")
        else:
            faults.require(problem_found is not None and problem_found.status == 503, f"B2: {problem_found} after {waited:.0f} s")
            time.sleep(max(0.0, seconds + 1 - waited))
    faults.require(service.client().submit(session, key="after"), "B2: no job is accepted afterwards")
    holder.close()
    print("B2: a lock of 1 s goes unnoticed, one of 30 s is answered 503, then jobs are accepted again")
    service.kill()
    service.remove()


def fill(place, left):
    """Takes the space of a disk except for `left` bytes."""
    with open(os.path.join(place, "filler"), "ab") as filler:
        filler.write(b"\0" * max(0, shutil.disk_usage(place).free - left))


def full_disk(args, faults):
    """B1: on a full disk no job fails, existing jobs are kept and deletes work; after space is freed, all jobs succeed."""
    place = tempfile.mkdtemp(prefix="wandless-disk-")
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", place], capture_output=True)
    if mount.returncode:
        print("B1: SKIPPED, no permission to mount a tmpfs")
        os.rmdir(place)
        return
    dice = random.Random(args.seed)
    answers = {}
    long, options = take(LONG, 4, seed=8), {"extrinsics": "fixed"}
    try:
        for n in range(args.disks):
            data = os.path.join(place, f"data{n}")
            service = Service(args.program, data=data, words=["--set", "limits.min_free_bytes=0"])
            service.start()
            client = service.client(patience_s=0.0)
            done = client.submit(client.upload(take(10, 2, seed=n))["id"], options=options)["id"]
            client.wait(done)
            blocker = client.submit(client.upload(long)["id"], options={"extrinsics": "refine"}, priority=5)["id"]
            waiting = [client.submit(client.upload(take(20, 3, seed=1000 + 10 * n + i))["id"], options=options)["id"] for i in range(3)]
            until(lambda: client.job(blocker)["state"] == "running", 30)
            left = dice.choice([0, 4096, 20_000, 100_000, 400_000])
            fill(place, left)
            states = [client.job(job)["state"] for job in waiting]
            faults.require(states == ["queued"] * 3, f"B1: the waiting jobs were {states} before the disk was full")
            for seed in range(3):
                try:
                    waiting.append(client.submit(client.upload(take(60, 4, seed=100 * n + seed))["id"], options=options)["id"])
                    code = "accepted"
                except wandless.Problem as problem:
                    code = f"{problem.status} {problem.code}"
                    faults.require(problem.status in (503, 507), f"B1: {problem}")
                except OSError as error:
                    code = f"broken connection {error}"
                    faults.require(False, f"B1: {code}")
                answers[code] = answers.get(code, 0) + 1
            faults.require(client.job(done)["state"] == "succeeded", "B1: a job was lost")
            for job in (done, blocker):
                try:
                    client.delete_job(job)
                except wandless.Problem as problem:
                    faults.require(False, f"B1: delete on a full disk: {problem}")
            until(lambda: not os.path.exists(os.path.join(data, "checkpoints", blocker)), 10)
            fill(place, left)  # also the space that was freed; now the waiting jobs run
            time.sleep(4.0)
            ends = [client.job(job) for job in waiting]
            failed = [(job["state"], (job["error"] or {}).get("code")) for job in ends if job["state"] in ("failed", "dead", "canceled")]
            faults.require(not failed, f"B1: {len(failed)} of {len(ends)} jobs ended because the disk was full: {failed[:3]}")
            os.remove(os.path.join(place, "filler"))
            waiting.append(client.submit(client.upload(take(20, 2, seed=9999 + n))["id"], options=options)["id"])
            until(lambda: all(client.job(job)["state"] in wandless.FINAL for job in waiting), 90)
            states = [client.job(job)["state"] for job in waiting]
            faults.require(set(states) == {"succeeded"}, f"B1: after space was freed the jobs are {states}")
            service.kill()
            whole = service.integrity()
            faults.require(whole == "ok", f"B1: {whole}")
            shutil.rmtree(data)
    finally:
        subprocess.run(["umount", "-l", place], check=False)
        os.rmdir(place)
    faults.require(any(code.startswith("507") for code in answers), f"B1: no upload met a full disk: {answers}")
    print(f"B1: {args.disks} full disks with waiting jobs: {answers}")


JUMPS = ("+1h", "-1h", "+10y", "-5y", "+0")


def clocks(args, faults):
    """B4: the wall clock jumps while jobs are queued and running, and between two starts."""
    library = faketime_library()
    if not library:
        print("B4: SKIPPED, faketime is not installed")
        return
    with tempfile.NamedTemporaryFile("w", delete=False) as file:
        file.write("+0")
    environment = {"LD_PRELOAD": library, "FAKETIME_TIMESTAMP_FILE": file.name, "FAKETIME_NO_CACHE": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
    service = Service(args.program, environment=environment)
    service.start()
    client = service.client()
    jobs, years = [running_job(service, client, 8, frames=400)], set()
    for restarts in (False, True):
        for offset in JUMPS:
            with open(file.name, "w") as clock:
                clock.write(offset)
            if restarts:
                service.kill()
                service.start()
                client = service.client()
            for n in range(2):
                session = client.upload(take(10, 2, seed=10 * len(jobs) + n))["id"]
                jobs.append(client.submit(session, options={"extrinsics": "fixed", "exports": []})["id"])
            years.add(client.job(jobs[-1])["created_at"][:4])
            until(lambda: client.job(jobs[-1])["state"] in wandless.FINAL, 0.5)
    patience = time.monotonic() + 120
    for job in jobs:
        while (done := client.job(job))["state"] not in wandless.FINAL and time.monotonic() < patience:
            time.sleep(0.05)
        faults.require(done["state"] == "succeeded" and done["attempt"] == 1, f"B4: {job} is {done['state']}, attempt {done['attempt']}")
        faults.require(all(s >= 0 for s in done["stage_seconds"].values()), f"B4: {done['stage_seconds']}")
        faults.require(client.request("GET", f"/v1/jobs/{job}/people").status == 200, "B4: no result")
    faults.require(len(years) >= 3, f"B4: the clock did not jump: {years}")
    listed = [job["id"] for job in client.jobs()]
    faults.require(listed == jobs[::-1] and len(set(jobs)) == len(jobs), "B4: the order of the list follows the clock")
    fences = sqlite3.connect(f"file:{service.data}/wandless.db?mode=ro", uri=True).execute("SELECT max(fence), sum(crashes) FROM jobs").fetchone()
    faults.require(fences[0] <= 1 + len(JUMPS) and fences[1] == 0, f"B4: claims and crashes {fences}")
    print(f"B4: {len(jobs)} jobs over {2 * len(JUMPS)} clock changes through the years {sorted(years)}: each ran once, in order")
    service.kill()
    service.remove()
    os.remove(file.name)


def main():
    args = arguments(__doc__, stops=50, cancels=40, disks=8, only="")
    faults = Faults()
    for check in (poison, paused, cancels, stops, held, full_disk, clocks):
        if args.only in check.__name__:
            check(args, faults)
    faults.end()


if __name__ == "__main__":
    main()
