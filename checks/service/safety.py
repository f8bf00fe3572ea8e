"""A7, A8, A14, F1 to F3, F5: jobs resume after their last finished stage; backup, restore and verify; damaged data folders;
identical bytes for identical input.

    python3 checks/service/safety.py --kills 20 --backups 20 --flips 100
"""

import json
import os
import random
import re
import shutil
import sqlite3
import struct
import subprocess
import tempfile
import threading
import time

from harness import Faults, Service, arguments, percentile, sha256, take, wandless

STAGES = ["cameras", "denoising", "held_out_check", "joint_trajectories", "metric_scale", "body_fit"]
OPTIONS = {"extrinsics": "fixed", "exports": []}


def run(service, *words):
    return subprocess.run([service.program, *words], capture_output=True, text=True)


def digests(client, job):
    return {file["name"]: file["sha256"] for file in client.manifest(job)["files"]}


def resume(args, faults):
    """A7, A8: kills the service in every stage, also damaging checkpoints; the result must equal that of an uninterrupted run.
    Stages of a few milliseconds need a program with the feature `failpoints`, which delays the start of each stage."""
    service = Service(args.program, environment={"WANDLESS_LOG": "info", "WANDLESS_LINGER_MS": "150"})
    service.start()
    client = service.client()
    session = client.upload(take(300, 4, seed=2))["id"]
    options = {"extrinsics": "refine", "exports": []}
    golden = client.submit(session, options=options)["id"]
    client.wait(golden)
    expected = digests(client, golden)
    dice = random.Random(args.seed)
    again, killed_in, resumed = [], {}, 0
    for n in range(args.kills * len(STAGES)):
        wanted = STAGES[n % len(STAGES)]
        client = service.client()
        job = client.submit(session, options=options)["id"]
        wait_for_stage(service, client, job, wanted)
        time.sleep(dice.uniform(0.0, 0.2))
        service.kill()
        kept = finished(service, job)
        has_ended = not os.path.isdir(os.path.join(service.data, "checkpoints", job))
        stage = "too late" if has_ended else next((name for name in STAGES if name not in kept), "none")
        killed_in[stage] = killed_in.get(stage, 0) + 1
        if n % 4 == 3:
            damage(service, job, dice)
            kept = []
        service.start()
        client = service.client()
        done = client.wait(job)
        faults.require(digests(client, job) == expected, f"A7: killed in {stage}: different bytes")
        faults.require(done["attempt"] == 1, f"A7: killed in {stage}: attempt {done['attempt']}")
        time.sleep(0.05)
        log = re.sub(r"(\x1b|\\x1b|\\u\{1b\})\[[0-9;]*m", "", "".join(service.stderr)).replace("\\", "")
        reused = [line for line in log.splitlines() if "resumed from its checkpoint" in line]
        again += [(stage, name, reused) for name in kept if not any(f'stage="{name}"' in line for line in reused)]
        resumed += len(kept)
        client.delete_job(job)
    faults.require(not again, f"A7: finished stages were run again: {again[:3]} ({len(again)})")
    faults.require(resumed > 0, "A7: no finished stage was ever reused")
    missed = [stage for stage in STAGES if not killed_in.get(stage)]
    if missed and not has_failpoints(args.program):
        print(f"A7: SKIPPED kills in {missed}: these stages last milliseconds in a program without the feature failpoints", flush=True)
    else:
        faults.require(not missed, f"A7: no kill in {missed}")
    print(f"A7, A8: killed in {killed_in}; {resumed} finished stages reused, all results identical", flush=True)
    service.kill()
    service.remove()


def has_failpoints(program):
    """Whether the program was built with the feature `failpoints`: then the environment can end its start."""
    with tempfile.TemporaryDirectory() as data:
        command = [program, "serve", "--listen", "127.0.0.1:0", "--data", data]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                              env={**os.environ, "WANDLESS_FAILPOINT": "start.locked"}) as process:
            has_started = "http://" in process.stdout.readline()
            process.kill()
    return not has_started


def wait_for_stage(service, client, job, stage):
    """Waits until the previous stage has its checkpoint (before the first: until the job runs), or the job has ended. The
    reported stage would be up to a second old."""
    folder, n = os.path.join(service.data, "checkpoints", job), STAGES.index(stage)
    begin = time.monotonic()
    while time.monotonic() < begin + 120:
        if STAGES[n - 1] in finished(service, job) if n else os.path.isdir(folder):
            return
        if not os.path.isdir(folder) and client.job(job)["state"] in wandless.FINAL:
            return
        time.sleep(0.002)


def finished(service, job):
    folder = os.path.join(service.data, "checkpoints", job)
    try:
        return [name[:-5] for name in os.listdir(folder) if name.endswith(".ckpt")]
    except FileNotFoundError:
        return []


def damage(service, job, dice):
    """Damages the checkpoints: a flipped bit, a truncated file, or a file of another release."""
    for name in finished(service, job):
        path = os.path.join(service.data, "checkpoints", job, name + ".ckpt")
        with open(path, "rb") as file:
            data = bytearray(file.read())
        how = dice.randrange(3)
        if how == 0:
            data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        elif how == 1:
            data = data[:dice.randrange(len(data))]
        else:
            data = data.replace(b"wandless-checkpoint ", b"wandless-checkpoint 9", 1)
        with open(path, "wb") as file:
            file.write(data)


def same_bytes(args, faults):
    """F5: five runs with one and two threads, with a restart after each."""
    results = []
    data = tempfile.mkdtemp(prefix="wandless-check-")
    for n, threads in enumerate((0, 1, 2, 0, 1)):
        service = Service(args.program, data=data, words=["--set", f"jobs.threads={threads}"])
        service.start()
        client = service.client()
        session = client.upload(take(60, 3, seed=6))["id"]
        job = client.submit(session, options={"exports": ["smpl_npz", "glb", "bvh"]}, key=str(n))["id"]
        client.wait(job)
        results.append(digests(client, job))
        service.stop()
    faults.require(all(result == results[0] for result in results), "F5: the same input gave different bytes")
    print(f"F5: five runs on one and two threads over five restarts: {len(results[0])} files, identical bytes", flush=True)
    shutil.rmtree(data)


def backups(args, faults):
    """F1, F2: backups under load, each restored and served."""
    service = Service(args.program, words=["--set", "jobs.concurrent=2"])
    service.start()
    over, times, n_jobs = threading.Event(), {"calm": [], "backup": []}, [0]
    at_backup = threading.Event()

    def load(seed):
        client, n = service.client(), 0
        while not over.is_set():
            n += 1
            session = client.upload(take(10, 2, seed=1000 * seed + n))["id"]
            job = client.submit(session, options=OPTIONS)["id"]
            n_jobs[0] += 1
            for _ in range(10):
                start = time.monotonic()
                client.job(job)
                times["backup" if at_backup.is_set() else "calm"].append(time.monotonic() - start)
                time.sleep(0.01)
            while client.job(job)["state"] not in wandless.FINAL and not over.is_set():
                time.sleep(0.02)
            if n % 5 == 0:
                client.delete_job(job)

    threads = [threading.Thread(target=load, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    place = tempfile.mkdtemp(prefix="wandless-backup-")
    time.sleep(3)
    for n in range(args.backups):
        at_backup.set()
        made = run(service, "backup", f"{place}/{n}", "--data", service.data)
        at_backup.clear()
        faults.require(made.returncode == 0, f"F1: backup {n}: {made.stderr}")
        faults.require(made.returncode or not unlisted(f"{place}/{n}"), f"F1: backup {n} omits {unlisted(f'{place}/{n}')[:3]}")
        time.sleep(0.3)
    over.set()
    for thread in threads:
        thread.join()
    longest = 0.0
    for n in range(args.backups):
        start = time.monotonic()
        back = Service(service.program, data=f"{place}/data{n}")
        restored = run(service, "restore", f"{place}/{n}", "--data", back.data)
        verified = run(service, "verify", f"{place}/{n}")
        faults.require(restored.returncode == 0 and verified.returncode == 0, f"F2: {n}: {restored.stderr} {verified.stdout} {verified.stderr}")
        if restored.returncode:
            continue
        faults.require(back.integrity() == "ok", f"F1: {n}: integrity")
        back.start()
        client = back.client()
        jobs = list(client.jobs())
        for job in jobs:
            done = job if job["state"] in wandless.FINAL else client.wait(job["id"])
            if done["state"] == "succeeded" and job is jobs[0]:
                client.download(done["id"], f"{place}/result{n}")
        if jobs and n % 5 == 0:
            for job in jobs:
                if client.job(job["id"])["state"] == "succeeded":
                    for name, digest in digests(client, job["id"]).items():
                        faults.require(sha256(client.artifact(job["id"], name)) == digest, f"F1: {n}: {name}")
        back.stop()
        whole = run(service, "verify", back.data)
        faults.require(whole.returncode == 0, f"F2: {n}: after serving: {whole.stdout}")
        longest = max(longest, time.monotonic() - start)
        shutil.rmtree(back.data)
    calm, busy = (percentile(times[kind], 0.99) * 1000 for kind in ("calm", "backup"))
    faults.require(busy <= 2 * calm + 20, f"F1: a status request takes {busy:.0f} ms (p99) during a backup, {calm:.0f} ms otherwise")
    print(f"F1, F2: {args.backups} backups under load of {n_jobs[0]} jobs, each restored, verified and served within {longest:.1f} s; "
          f"p99 {calm:.0f} ms, {busy:.0f} ms during a backup", flush=True)
    service.kill()
    service.remove()
    shutil.rmtree(place)


def unlisted(backup):
    """Files that the rows of the backup refer to, but its list omits."""
    with open(os.path.join(backup, "backup.json")) as file:
        listed = {entry["name"] for entry in json.load(file)["files"]}
    with sqlite3.connect(f"file:{backup}/wandless.db?mode=ro&immutable=1", uri=True) as database:
        named = [f"sessions/{row[0]}" for row in database.execute("SELECT id FROM sessions")]
        named += [f"results/{row[0]}/{row[1]}/{row[2]}" for row in
                  database.execute("SELECT job_id, result_fence, name FROM artifacts JOIN jobs ON jobs.id = job_id")]
    return [name for name in named if name not in listed]


def live_bytes(log):
    """Bytes of the current generation in the write-ahead log of a killed service."""
    with open(log, "rb") as file:
        data = file.read()
    size, salts, at = struct.unpack(">I", data[8:12])[0], data[16:24], 32
    while at + 24 + size <= len(data) and data[at + 8:at + 16] == salts:
        at += 24 + size
    return at if at > 32 else 0


def flips(args, faults):
    """F3: flips one bit in any file of a stopped and of a killed service; a damaged result must not be served."""
    service = Service(args.program)
    service.start()
    client = service.client()
    jobs = [client.submit(client.upload(take(10, 2, seed=n))["id"], options={**OPTIONS, "seed": n}, labels={"note": "x" * 200})["id"] for n in range(8)]
    for job in jobs:
        client.wait(job)
    long = client.submit(client.upload(take(3000, 4, seed=50))["id"], options={"extrinsics": "refine"})["id"]
    while not finished(service, long):
        time.sleep(0.05)
    time.sleep(2.5)
    client.submit(client.upload(take(10, 2, seed=90))["id"], options=OPTIONS, labels={"late": "y" * 200})
    service.kill()
    whole = run(service, "verify", service.data)
    faults.require(whole.returncode == 0, f"F3: the folder of the killed service does not verify: {whole.stdout}")
    dice = random.Random(args.seed)
    detected, missed = {}, []
    for state in ("killed", "stopped"):
        if state == "stopped":
            service.start()
            service.stop()
        paths = {"database": [os.path.join(service.data, "wandless.db")], "log": [os.path.join(service.data, "wandless.db-wal")]}
        for kind, folder in (("result", "results"), ("input", "sessions"), ("checkpoint", "checkpoints")):
            paths[kind] = [os.path.join(base, name) for base, _, names in os.walk(os.path.join(service.data, folder)) for name in names
                           if folder != "checkpoints" or name.endswith(".ckpt")]
        in_log = pages_of_log(paths["log"][0]) if os.path.exists(paths["log"][0]) else set()
        for kind, files in paths.items():
            files = [path for path in files if os.path.exists(path) and os.path.getsize(path)]
            if kind == "result":
                files = [path for path in files if ".tmp/" not in path]
            for _ in range(args.flips if files else 0):
                path = dice.choice(files)
                end = live_bytes(path) if kind == "log" else os.path.getsize(path)
                at = dice.randrange(end) if end else None
                while kind == "database" and at // 4096 + 1 in in_log:
                    at = dice.randrange(end)  # the log contains the page, and this copy will be overwritten
                if at is None:
                    continue
                backup = path + ".whole"
                shutil.copy(path, backup)
                with open(path, "r+b") as file:
                    file.seek(at)
                    byte = file.read(1)[0]
                    file.seek(at)
                    file.write(bytes([byte ^ 1 << dice.randrange(8)]))
                found = run(service, "verify", service.data)
                if found.returncode == 0:
                    missed.append((state, kind, os.path.basename(path), at))
                detected[state, kind] = detected.get((state, kind), 0) + 1
                shutil.move(backup, path)
                if os.path.exists(os.path.join(service.data, "wandless.db-shm")) and state == "killed":
                    os.remove(os.path.join(service.data, "wandless.db-shm"))
    faults.require(not missed, f"F3: {len(missed)} flips were not detected: {missed[:5]}")
    service.start()
    client = service.client()
    people = next(os.path.join(base, name) for base, _, names in os.walk(os.path.join(service.data, "results", jobs[0])) for name in names if name == "people.json")
    with open(people, "r+b") as file:
        file.write(b"X")
    try:
        client.request("GET", f"/v1/jobs/{jobs[0]}/people")
        faults.require(False, "F3: a damaged file was served")
    except wandless.Problem as problem:
        faults.require(problem.status == 500 and problem.code == "corrupt", f"F3: {problem}")
    service.kill()
    print(f"F3: flips detected: { {' '.join(k): v for k, v in detected.items()} }, missed {len(missed)}; a damaged file is answered `corrupt`", flush=True)
    service.remove()


def pages_of_log(log):
    with open(log, "rb") as file:
        data = file.read()
    size, end = (struct.unpack(">I", data[8:12])[0], live_bytes(log)) if len(data) > 32 else (0, 0)
    return {struct.unpack(">I", data[at:at + 4])[0] for at in range(32, end, 24 + size)} if end else set()


def damaged_folders(args, faults):
    """A14: every damage gives a specific error or a failed job; a lost database is never silently replaced."""
    whole = Service(args.program)
    whole.start()
    client = whole.client()
    session = client.upload(take(10, 2, seed=1))["id"]
    done = client.submit(session, options=OPTIONS)["id"]
    client.wait(done)
    blocker = client.submit(client.upload(take(3000, 4, seed=2))["id"], options={"extrinsics": "fixed"}, priority=5)["id"]
    queued = client.submit(session, options={**OPTIONS, "seed": 1})["id"]
    whole.kill()

    def remove(*names):
        return lambda data: [shutil.rmtree(p) if os.path.isdir(p) else os.remove(p) for p in (os.path.join(data, name) for name in names) if os.path.exists(p)]

    def emptied(data):
        remove("wandless.db-wal", "wandless.db-shm")(data)
        open(os.path.join(data, "wandless.db"), "wb").close()

    def garbled(data):
        remove("wandless.db-wal", "wandless.db-shm")(data)
        with open(os.path.join(data, "wandless.db"), "r+b") as file:
            file.write(b"not a database at all" * 100)

    def cut(data):
        remove("wandless.db-wal", "wandless.db-shm")(data)
        os.truncate(os.path.join(data, "wandless.db"), 5000)

    def newer(data):
        with sqlite3.connect(os.path.join(data, "wandless.db")) as database:
            database.execute("INSERT INTO _sqlx_migrations SELECT 9999, 'later', installed_on, success, checksum, 0 FROM _sqlx_migrations LIMIT 1")

    def other(name):
        def change(data):
            with open(os.path.join(data, "sessions", session), "wb") as file:
                file.write(name)
        return change

    def folder_is_file(data):
        remove("results")(data)
        open(os.path.join(data, "results"), "w").close()

    # The damage and the expected outcome: the start is `refused`, or the states of the finished and of the queued job.
    cases = {"database emptied": (emptied, "refused"), "database gone": (remove("wandless.db", "wandless.db-wal", "wandless.db-shm"), "refused"),
             "database not a database": (garbled, "refused"), "database cut": (cut, "refused"), "database of a newer release": (newer, "refused"),
             "results is a file": (folder_is_file, "refused"), "results gone": (remove("results"), "corrupt"),
             "input gone": (remove("sessions/" + session), "failed"), "input emptied": (other(b""), "failed"),
             "input of other bytes": (other(json.dumps(take(10, 2, seed=7)).encode()), "failed"),
             "tmp and checkpoints gone": (remove("tmp", "checkpoints", "reserve", "lock"), "fine"), "digests gone": (remove("wandless.db.pages"), "fine"),
             "folder read-only": (None, "refused"), "folder of another": (None, "refused")}
    outcomes = {}
    for name, (harm, expected) in cases.items():
        data = tempfile.mkdtemp(prefix="wandless-damaged-")
        os.rmdir(data)
        shutil.copytree(whole.data, data)
        prefix = ()
        if harm:
            harm(data)
        else:
            os.chmod(data, 0o755)
            prefix = ("setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups")
        service = Service(args.program, data=data, prefix=prefix)
        started = service.start()
        if expected == "refused":
            text = "".join(service.stderr).strip()
            faults.require(started is None and service.process.returncode == 1 and "wandless:" in text and len(text) < 400, f"A14 {name}: {started} {text[:300]}")
            outcomes[name] = text.split(": ", 1)[-1][-90:]
            if started is not None:
                service.kill()
        else:
            faults.require(started is not None, f"A14 {name}: the service does not start")
            client = service.client()
            client.delete_job(blocker)
            end = final_state(client, queued)
            outcomes[name] = end
            faults.require(end == ("failed" if expected == "failed" else "succeeded"), f"A14 {name}: the queued job is {end}")
            try:
                client.request("GET", f"/v1/jobs/{done}/people")
                found = "fine"
            except wandless.Problem as problem:
                found = problem.code
            faults.require(found == ("corrupt" if expected == "corrupt" else "fine"), f"A14 {name}: the result is {found}")
            service.kill()
        shutil.rmtree(data, ignore_errors=True)
    print(f"A14: {outcomes}", flush=True)
    whole.remove()


def final_state(client, job):
    try:
        return client.wait(job)["state"]
    except wandless.JobFailed as failed:
        return failed.job["state"]


def main():
    args = arguments(__doc__, kills=4, backups=20, flips=100, only="")
    faults = Faults()
    for check in (damaged_folders, same_bytes, resume, flips, backups):
        if args.only in check.__name__:
            check(args, faults)
    faults.end()


if __name__ == "__main__":
    main()
