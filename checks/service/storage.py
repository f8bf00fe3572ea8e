"""Disk, database and backups: a nearly full disk, quotas, bounded lists, a hundred thousand jobs, file modes, backups,
read-only media, and a clock that jumped.

    python3 checks/service/storage.py --program target/release/wandless [--row N]

A full disk and read-only media need permission to mount a tmpfs; without it, these parts are skipped with a message.
"""

import contextlib
import json
import os
import shutil
import socket
import sqlite3
import stat
import subprocess
import sys
import tempfile
import threading
import time

from harness import Failed, Service, arguments, percentile, require, take, until, wandless

FIXED = {"extrinsics": "fixed", "exports": []}


def words(settings):
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


@contextlib.contextmanager
def serving(args, data=None, **settings):
    """A service; `settings` have `__` for the dot of a name."""
    service = Service(args.program, data=data, words=words(dotted(settings)))
    try:
        require(service.start() is not None, "the service does not start")
        yield service
    finally:
        if service.process and service.process.poll() is None:
            service.kill()
        service.remove()


def dotted(settings):
    return {key.replace("__", "."): value for key, value in settings.items()}


def restart(service, **settings):
    service.stop()
    service.words = words(dotted(settings))
    require(service.start() is not None, "the service does not start again")
    return service.client(patience_s=0.0)


def changed(service, change):
    """Stops the service and changes its database; the digests of the pages no longer hold then."""
    service.stop()
    with contextlib.closing(sqlite3.connect(os.path.join(service.data, "wandless.db"))) as database, database:
        change(database)
    with contextlib.suppress(FileNotFoundError):
        os.remove(os.path.join(service.data, "wandless.db.pages"))


def refusal(call):
    """The problem with which a call is refused, or None."""
    try:
        call()
    except wandless.Problem as problem:
        return problem
    return None


def is_refused(problem, status, code):
    return problem is not None and problem.status == status and problem.code == code


@contextlib.contextmanager
def small_disk(megabytes):
    """A tmpfs; None where it cannot be mounted."""
    place = tempfile.mkdtemp(prefix="wandless-disk-")
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", place], capture_output=True)
    try:
        yield place if made.returncode == 0 else None
    finally:
        subprocess.run(["umount", "-l", place], capture_output=True)
        shutil.rmtree(place, ignore_errors=True)


def row_1(args):
    """No claims and no submissions below the minimum of free bytes; a full disk puts jobs back."""
    with serving(args) as service:
        client = service.client()
        session = client.upload(take(10, 2, seed=1))["id"]
        blocker = client.submit(client.upload(take(4000, 4, seed=2))["id"], options=FIXED, priority=9)["id"]
        queued = [client.submit(session, options={**FIXED, "seed": n})["id"] for n in range(args.waiting)]
        require(until(lambda: client.job(blocker)["state"] == "running", 20), "no job runs")
        client = restart(service, limits__min_free_bytes=10**15)
        time.sleep(4)
        states = {client.job(job)["state"] for job in [blocker, *queued]}
        require(states == {"queued"}, f"jobs are {states} below the minimum of free bytes")
        problem = refusal(lambda: client.submit(session, options=FIXED))
        require(is_refused(problem, 507, "disk_full"), f"a submission below the minimum: {problem or 202}")
        client = restart(service)
        client.delete_job(blocker)
        require(all(client.wait(job)["state"] == "succeeded" for job in queued), "a job was lost")
    full = full_disk(args)
    return f"{args.waiting} jobs waited below the minimum, a submission was answered 507, then all succeeded; {full}"


def full_disk(args):
    with small_disk(64) as place:
        if place is None:
            return "full disk SKIPPED, no permission to mount a tmpfs"
        with serving(args, data=os.path.join(place, "data"), limits__min_free_bytes=0) as service:
            client = service.client(patience_s=0.0)
            session = client.upload(take(150, 3, seed=3))["id"]
            first = client.submit(session, options={"extrinsics": "fixed"})["id"]
            client.wait(first)
            blocker = client.submit(client.upload(take(4000, 4, seed=2))["id"], options=FIXED, priority=9)["id"]
            require(until(lambda: client.job(blocker)["state"] == "running", 20), "no job runs")
            jobs = [client.submit(session, options={"extrinsics": "fixed", "seed": n})["id"] for n in range(1, args.waiting + 1)]
            client.delete_job(blocker)
            service.stop()
            filler = os.path.join(place, "filler")
            with open(filler, "wb") as file:
                file.write(b"\0" * (shutil.disk_usage(place).free - 200_000))
            client = restart(service, limits__min_free_bytes=0)
            patience = 60 + 10 * args.waiting

            met = set()

            def tried():
                found = [client.job(job) for job in jobs]
                met.update(job["id"] for job in found if job["state"] == "failed" or "next try" in job["progress"]["message"])
                # A small result may still fit, so that fewer than three jobs meet the full disk.
                return len(met) >= 3 or all(job["id"] in met or job["state"] in wandless.FINAL for job in found)

            require(until(tried, patience) and met, f"{len(met)} jobs met the full disk")
            states = [client.job(job)["state"] for job in jobs]
            require("failed" not in states, f"jobs on a full disk are {states}")
            os.remove(filler)
            require(until(lambda: all(client.job(job)["state"] == "succeeded" for job in jobs), patience),
                    f"after space was freed the jobs are {[client.job(job)['state'] for job in jobs]}")
    return f"{len(met)} jobs were put back on a full disk, and all succeeded after space was freed"


def row_4(args):
    """Names, labels, exports and the pages of lists are bounded."""
    with serving(args) as service:
        client = service.client(patience_s=0.0)
        session = client.upload(take(10, 2, seed=1))["id"]
        name = refusal(lambda: client.upload({**take(10, 2, seed=2), "name": "x" * 300}))
        require(is_refused(name, 422, "name_too_long"), f"a name of 300 bytes: {name or 201}")
        labels = refusal(lambda: client.submit(session, options=FIXED, labels={str(n): "x" * 250 for n in range(20)}))
        require(is_refused(labels, 400, "malformed"), f"labels of 5 KB: {labels or 202}")
        job = client.submit(session, options={"extrinsics": "fixed", "exports": ["glb", "bvh"] * 25_000})
        require(job["options"]["exports"] == ["glb", "bvh"], f"{len(job['options']['exports'])} exports are kept")
        client.delete_job(job["id"])
        changed(service, lambda database: [database.execute(
            """INSERT INTO sessions (id, tenant, sha256, bytes, name, cameras, n_frames, people_max, keypoint_convention,
                                     format, warnings, created_at)
               SELECT 'session_' || ?1, tenant, ?1, bytes, ?2, cameras, n_frames, people_max, keypoint_convention, format,
                      warnings, created_at FROM sessions WHERE id = ?3""", (str(n), "x" * 500_000, session))
            for n in range(60)])
        require(service.start() is not None, "the service does not start again")
        before, peak, over = service.rss_mib(), [0.0], threading.Event()

        def watch():
            while not over.is_set():
                peak[0] = max(peak[0], service.rss_mib())
                time.sleep(0.02)

        sizes, counts = [], []

        def read():
            client, token, n = service.client(), "", 0
            while token is not None:
                answer = client.request("GET", f"/v1/sessions?page_size=500&page_token={token}").body
                page = json.loads(answer)
                sizes.append(len(answer))
                n, token = n + len(page["sessions"]), page["next_page_token"]
            counts.append(n)

        threads = [threading.Thread(target=read) for _ in range(16)]
        for thread in [threading.Thread(target=watch, daemon=True), *threads]:
            thread.start()
        for thread in threads:
            thread.join()
        over.set()
        require(counts == [61] * 16, f"the pages of 61 sessions have {counts}")
        require(max(sizes) <= 2 << 20, f"a page has {max(sizes) >> 20} MiB")
        require(peak[0] - before <= 150, f"16 lists take {peak[0] - before:.0f} MiB")
    return f"longest page {max(sizes) >> 10} KiB, 16 clients took {peak[0] - before:.0f} MiB, exports 2 of 50,000"


def announce(service, length):
    """Begins an upload; returns its connection."""
    connection = socket.create_connection(("127.0.0.1", service.port))
    head = f"POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1:{service.port}\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
    connection.sendall(head.encode() + b"{" + b" " * 1000)
    time.sleep(0.5)
    return connection


def answer_within(connection, seconds):
    connection.settimeout(seconds)
    try:
        return connection.recv(4096).decode("latin-1")
    except TimeoutError:
        return "no answer"


def row_8(args):
    """Quotas bind submissions; uploads count when they announce their length."""
    with serving(args) as service:
        client = service.client()
        session = client.upload(take(10, 2, seed=1))["id"]
        client = restart(service, tenants__max_bytes=1000)
        problem = refusal(lambda: client.submit(session, options=FIXED))
        require(is_refused(problem, 507, "quota_exceeded"), f"a submission above the quota: {problem or 202}")
        restart(service, tenants__max_bytes=10_000_000)
        refused = {}
        for name, length, code, settings in [
            ("quota", 6_000_000, "quota_exceeded", None),
            ("disk", 1_900_000_000, "disk_full", {"limits__min_free_bytes": -3_000_000_000}),
        ]:
            if settings:
                free = shutil.disk_usage(service.data).free
                restart(service, limits__min_free_bytes=free + settings["limits__min_free_bytes"])
            first, second = announce(service, length), announce(service, length)
            found = answer_within(second, 8)
            require("507" in found[:20], f"{name}: a second upload in flight: {found[:60]}")
            require(answer_within(first, 0.1) == "no answer", f"{name}: the first upload was refused")
            refused[name] = code
            first.close()
            second.close()
            time.sleep(0.3)
            third = announce(service, length)
            require(answer_within(third, 3) == "no answer", f"{name}: refused after the other uploads ended")
            third.close()
    return f"a submission and second uploads in flight are answered 507 ({', '.join(refused.values())})"


def fill(database, session, n_jobs):
    error = json.dumps({"code": "x", "detail": "y", "remedy": "z"})
    rows = ((f"job_{n:032x}", session, json.dumps({"scene": str(n % 1000), "all": "x"}), "failed" if n % 100 == 0 else "canceled",
             error if n % 100 == 0 else None) for n in range(n_jobs))
    database.executemany(
        """INSERT INTO jobs (id, session_id, options, labels, priority, state, error, created_at, finished_at, result_bytes)
           VALUES (?, ?, '{}', ?, 0, ?, ?, '2026-01-01T00:00:00.000Z', '2026-01-01T00:00:00.000Z', 1)""", rows)


def read_bytes(service):
    with open(f"/proc/{service.process.pid}/io") as counters:
        return next(int(line.split()[1]) for line in counters if line.startswith("rchar"))


def row_13(args):
    """A hundred thousand jobs: lists by label and state, uploads, checkpoints."""
    with serving(args) as service:
        client = service.client()
        session = client.upload(take(10, 2, seed=1))["id"]
        changed(service, lambda database: fill(database, session, args.jobs))
        require(service.start() is not None, "the service does not start again")
        times = {}
        for name, query, found in [("label", "label=scene%3D77", args.jobs // 1000), ("state", "state=failed", args.jobs // 100)]:
            times[name] = []

            def read(seconds=times[name], path=f"/v1/jobs?page_size=50&{query}", found=min(50, found)):
                client = service.client()
                for _ in range(4):
                    start = time.monotonic()
                    page = client.json("GET", path)
                    seconds.append(time.monotonic() - start)
                    require(len(page["jobs"]) == found, f"{path}: {len(page['jobs'])} jobs")

            threads = [threading.Thread(target=read) for _ in range(16)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            require(len(times[name]) == 64, f"lists by {name} failed")
        uploads = []
        for seed in range(2, 9):
            start = time.monotonic()
            client.upload(take(10, 2, seed=seed))
            uploads.append(time.monotonic() - start)
        time.sleep(6)  # the first checkpoint computes all digests
        size, before = os.path.getsize(os.path.join(service.data, "wandless.db")), read_bytes(service)
        client.upload(take(10, 2, seed=99))
        time.sleep(6)
        read = read_bytes(service) - before
    medians = {name: percentile(values, 0.5) for name, values in [*times.items(), ("upload", uploads)]}
    for name, limit in [("label", 0.5), ("state", 0.5), ("upload", 0.2)]:
        require(medians[name] <= limit, f"{name}: p50 {medians[name] * 1000:.0f} ms with {args.jobs} jobs")
    require(read <= size / 4, f"a checkpoint reads {read >> 10} KiB of a database of {size >> 10} KiB")
    return (f"{args.jobs} jobs: p50 of 16 clients by label {medians['label'] * 1000:.0f} ms, by state {medians['state'] * 1000:.0f} ms; "
            f"upload {medians['upload'] * 1000:.0f} ms; an upload and its checkpoint read {read >> 10} of {size >> 10} KiB")


def mode(*path):
    return stat.S_IMODE(os.stat(os.path.join(*path)).st_mode)


def row_14(args):
    """The data folder, the database and backups are readable by their owner alone."""
    place = tempfile.mkdtemp(prefix="wandless-check-")
    old = os.umask(0o022)
    try:
        with serving(args, data=os.path.join(place, "data")) as service:
            service.client().upload(take(10, 2, seed=1))
            time.sleep(3)
            names = ["wandless.db", "wandless.db-wal", "wandless.db-shm", "wandless.db.pages", "lock", "reserve"]
            require(mode(service.data) == 0o700, f"the data folder has mode {mode(service.data):o}")
            modes = {name: f"{mode(service.data, name):o}" for name in names}
            require(set(modes.values()) == {"600"}, f"{modes}")
            service.stop()
            os.chmod(service.data, 0o755)
            os.chmod(os.path.join(service.data, "wandless.db"), 0o644)
            service.start()
            again = mode(service.data), mode(service.data, "wandless.db")
            require(again == (0o700, 0o600), f"an existing folder and database keep the modes {again}")
            backup = os.path.join(place, "backup")
            made = subprocess.run([args.program, "backup", backup, "--data", service.data], capture_output=True, text=True)
            require(made.returncode == 0, made.stderr)
            modes = {name: f"{mode(backup, name):o}" for name in os.listdir(backup) if os.path.isfile(os.path.join(backup, name))}
            require(mode(backup) == 0o700 and set(modes.values()) == {"600"}, f"backup {mode(backup):o}: {modes}")
    finally:
        os.umask(old)
        shutil.rmtree(place, ignore_errors=True)
    return "folder 0700, database, log, digests and backup 0600, also after a start on a looser folder"


def row_16(args):
    """Backups with similar and relative names, a killed backup, registered bodies."""
    place = tempfile.mkdtemp(prefix="wandless-check-")

    def run(*line):
        done = subprocess.run([os.path.abspath(args.program), *line], cwd=place, capture_output=True, text=True)
        require(done.returncode == 0, f"{' '.join(line)}: exit code {done.returncode}: {done.stderr.strip()}")
        return done.stdout

    try:
        with serving(args) as service:
            service.client().upload(take(10, 2, seed=1))
            run("body", "export", "--out", "body.npz")
            run("body", "add", "studio", "body.npz", "--data", service.data)
            os.makedirs(os.path.join(place, "nightly.tmp"))
            open(os.path.join(place, "nightly.tmp", "notes"), "w").close()
            stale = os.path.join(place, ".nightly.2026-11-22.staging_0.partial")
            os.makedirs(stale)
            for night in ("nightly.2026-11-21", "nightly.2026-11-22"):
                run("backup", night, "--data", service.data)
                run("verify", night)
            require(not os.path.exists(stale), "the folder of a killed backup is still there")
            require(not [name for name in os.listdir(place) if name.endswith(".partial")], "a staging folder is left")
            run("restore", "nightly.2026-11-22", "--data", "restored")
            bodies = run("body", "list", "--data", "restored")
            require("studio" in bodies, f"the restored folder has the bodies {bodies!r}")
    finally:
        shutil.rmtree(place, ignore_errors=True)
    return "two backups by relative names beside `nightly.tmp`, exit code 0; the stale folder is gone, the body is restored"


def shift_times(database, years):
    """Makes everything older, as if the clock had jumped ahead while the service was stopped."""
    for table, columns in [("jobs", ("created_at", "started_at", "finished_at")), ("sessions", ("created_at",)), ("idempotency", ("created_at",))]:
        for column in columns:
            database.execute(f"UPDATE {table} SET {column} = strftime('%Y-%m-%dT%H:%M:%fZ', {column}, '-{years} years') WHERE {column} IS NOT NULL")
    if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'clock'").fetchone():
        database.execute(f"UPDATE clock SET seen_at = seen_at - {years} * 31556952")


def row_17(args):
    """Low: a clock that jumped, keys after a deletion, old keys, a large empty database, read-only media."""
    with serving(args) as service:
        client = service.client(patience_s=0.0)
        session = client.upload(take(10, 2, seed=1))["id"]
        job = client.submit(session, options=FIXED, key="once")["id"]
        client.wait(job)
        gone = client.submit(session, options=FIXED, key="gone")["id"]
        client.wait(gone)
        client.delete_job(gone)
        client.delete_session(session)
        again = client.submit(session, options=FIXED, key="once")
        require(again["id"] == job, "the key gives another job after its session was deleted")

        changed(service, lambda database: database.execute(
            "UPDATE idempotency SET created_at = strftime('%Y-%m-%dT%H:%M:%fZ', 'now', '-40 days')"))
        service.start()
        time.sleep(2)
        keys = read_rows(service, "SELECT key FROM idempotency ORDER BY key")
        require(keys == [("once",)], f"after 40 days the keys {keys} are kept, of which only `once` has a job")

        changed(service, lambda database: shift_times(database, 10))
        service.words = words({"retention.jobs_days": 30, "retention.sessions_days": 30})
        service.start()
        time.sleep(3)
        jobs = [job["id"] for job in service.client().jobs()]
        require(jobs == [job], f"after the clock jumped by 10 years the jobs are {jobs}")

        changed(service, inflate)
        large = os.path.getsize(os.path.join(service.data, "wandless.db"))
        service.start()
        service.client().upload(take(10, 2, seed=2))
        path = os.path.join(service.data, "wandless.db")
        shrunk = until(lambda: os.path.getsize(path) < large / 2, 30)
        require(shrunk, f"the database has {os.path.getsize(path) >> 20} of {large >> 20} MiB after everything was deleted")
        small = os.path.getsize(path)
        time.sleep(3)
        media = read_only(args, service)
    return f"key kept, 1 old key forgotten, no job removed after a jump of 10 years, {large >> 20} MiB shrunk to {small >> 20}; {media}"


def read_rows(service, query):
    with contextlib.closing(sqlite3.connect(f"file:{service.data}/wandless.db?mode=ro", uri=True)) as database:
        return database.execute(query).fetchall()


def inflate(database):
    database.execute("CREATE TABLE filler (bytes BLOB)")
    database.executemany("INSERT INTO filler VALUES (randomblob(4000))", ((),) * 10_000)
    database.commit()
    database.execute("DELETE FROM filler")
    database.execute("DROP TABLE filler")


def read_only(args, service):
    """Verifies a killed and a stopped data folder on read-only media."""
    with small_disk(256) as place:
        if place is None:
            return "read-only media SKIPPED, no permission to mount a tmpfs"
        service.client().upload(take(10, 2, seed=3))
        service.kill()
        shutil.copytree(service.data, os.path.join(place, "killed"))
        service.start()
        service.stop()
        shutil.copytree(service.data, os.path.join(place, "stopped"))
        subprocess.run(["mount", "-o", "remount,ro", place], check=True)
        for name in ("killed", "stopped"):
            done = subprocess.run([args.program, "verify", os.path.join(place, name)], capture_output=True, text=True)
            require(done.returncode == 0, f"verify on read-only media, {name}: {done.stdout.strip()} {done.stderr.strip()}")
    return "killed and stopped folders verified on read-only media"


ROWS = {1: row_1, 4: row_4, 8: row_8, 13: row_13, 14: row_14, 16: row_16, 17: row_17}


def main():
    args = arguments(__doc__, row=0, jobs=100_000, waiting=3)
    failed = False
    for number, check in ROWS.items():
        if args.row in (0, number):
            start = time.monotonic()
            try:
                print(f"row {number}: held: {check(args)} ({time.monotonic() - start:.0f} s)", flush=True)
            except Exception as error:  # an unexpected answer of the service is a failure, too
                kind = "" if isinstance(error, Failed) else f"{type(error).__name__}: "
                print(f"row {number}: FAILED: {kind}{error}", flush=True)
                failed = True
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
