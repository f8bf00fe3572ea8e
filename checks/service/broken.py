"""Rows of `scale.py`: PostgreSQL and the object store through proxies that break what they pass on."""

import os
import shutil
import subprocess
import threading
import time

from cluster import Cluster, wait_for
from harness import faketime_library, require, take, until, wandless
from proxies import PostgresProxy, StoreProxy
from states import FIXED, all_final, check_objects, final_states


def lost_answers(options):
    """Answers to COMMIT are eaten: nothing is lost or done twice, and a claim whose answer was lost comes back."""
    cluster = Cluster(options.program, options.s3, beat_s=0.3, lease_s=1.5)
    try:
        session = cluster.node("api").client().upload(take(8))["id"]
        proxy = PostgresProxy(cluster.postgres.port)
        through = {"WANDLESS_STORE__URL": proxy.url("wandless")}
        client = cluster.node("api", **through).client()
        for _ in range(2):
            cluster.node("worker", **through)
        proxy.eat = 0.34
        jobs, canceled, n = [], [], 0
        while min(proxy.eaten.get(kind, 0) for kind in ("accept", "claim", "finish", "cancel")) < options.eaten:
            jobs.append(client.submit(session, FIXED, key=f"key {n}")["id"])
            if n % 2:
                again = client.submit(session, FIXED, key=f"canceled {n}")["id"]
                canceled.append(again)
                client.cancel(again)
            n += 1
            wait_for(lambda: sum(map(int, final_states(cluster).values())) - len(canceled) - n < 20 and open_jobs(cluster) < 6, 60, "the jobs end")
        proxy.eat = 0.0
        slowest = wait_for(lambda: all_final(cluster), 60, "all jobs end")
        states = final_states(cluster)
        total = len(jobs) + len(canceled)
        require(sum(states.values()) == total == len(set(jobs + canceled)), f"{total} jobs were accepted, there are {states}")
        require(states.get("succeeded", 0) >= len(jobs) and set(states) <= {"succeeded", "canceled"}, f"states: {states}")
        require({client.job(job)["state"] for job in jobs} == {"succeeded"}, "a job that was not canceled did not succeed")
        counted = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE crashes > 0")
        require(counted == [["0"]], "a lost answer was counted as a crash")
        n_files, strays = check_objects(cluster)
        return f"eaten: {proxy.eaten}; {total} jobs, 0 lost, 0 doubled, {n_files} objects right, {strays} strays; the last ended {slowest:.1f} s later"
    finally:
        cluster.remove()


def open_jobs(cluster):
    states = final_states(cluster)
    return sum(states.get(state, 0) for state in ("queued", "running", "canceling"))


def paused_transaction(options):
    """A node that stands still inside a transaction holds up the claims of others for six seconds at most."""
    cluster = Cluster(options.program, options.s3)
    try:
        api = cluster.node("api").client()
        session = api.upload(take(8))["id"]
        proxy = PostgresProxy(cluster.postgres.port)
        paused = cluster.node("api", WANDLESS_STORE__URL=proxy.url("wandless"))
        cluster.node("worker")
        slowest = 0.0
        for _ in range(options.pauses):
            proxy.paused.clear()
            proxy.resume.clear()
            proxy.pause_after = "accept"  # the tenant's row is locked
            threading.Thread(target=submit_quietly, args=(paused.client(patience_s=5.0), session), daemon=True).start()
            require(proxy.paused.wait(20), "no transaction was paused")
            start = time.monotonic()
            job = api.submit(session, FIXED)["id"]
            wait_for(lambda job=job: api.job(job)["started_at"] is not None, 20, "the next claim")
            slowest = max(slowest, time.monotonic() - start)
            proxy.resume.set()
        wait_for(lambda: all_final(cluster), 120, "all jobs end")
        require(slowest <= 6.0 + 1.0, f"a claim waited for {slowest:.1f} s")
        check_objects(cluster)
        return f"{options.pauses} transactions paused: accepted and claimed after {slowest:.1f} s at most"
    finally:
        cluster.remove()


def submit_quietly(client, session):
    try:
        client.submit(session, FIXED)
    except (wandless.Problem, OSError):
        pass  # the node is paused on purpose


def wrong_clocks(options):
    """Nodes whose clocks are an hour or ten years off: no job is put back, and the order of the jobs is kept."""
    library = faketime_library()
    if not library:
        print("SKIPPED: clocks that are off, because faketime is not installed", flush=True)
        return "skipped"
    cluster = Cluster(options.program, None, beat_s=0.3, lease_s=1.5)  # a store with signed requests refuses such clocks
    try:
        api = cluster.node("api").client()
        for shift in ("+1h", "-1h", "+10y"):
            node = cluster.node("all", LD_PRELOAD=library, FAKETIME=shift, FAKETIME_DONT_FAKE_MONOTONIC="1")
            require(node.process.poll() is None, "a node with another clock does not start")
        session = api.upload(take(30))["id"]
        jobs = [api.submit(session, FIXED)["id"] for _ in range(9)]
        wait_for(lambda: all_final(cluster), 180, "all jobs end")
        rows = cluster.postgres.ask("SELECT id, state, fence, losses FROM jobs ORDER BY seq")
        require([row[0] for row in rows] == jobs, "the order of the jobs has changed")
        put_back = [row for row in rows if row[1:] != ["succeeded", "1", "0"]]
        require(not put_back, f"put back: {put_back}")
        check_objects(cluster)
        return f"{len(jobs)} jobs on clocks of +1 h, -1 h and +10 y: 0 put back"
    finally:
        cluster.remove()


def broken_store(options):
    """An object store that fails, stalls, cuts uploads and gives other bytes: what was accepted can be read, and never as other bytes."""
    if not options.s3:
        return "skipped: no S3 server"
    cluster = Cluster(options.program, options.s3)
    try:
        plain = cluster.node("all").client()
        session = plain.upload(take(12))["id"]
        expected = plain.manifest(plain.wait(plain.submit(session, FIXED)["id"])["id"])
        proxy = StoreProxy(cluster.store.port)
        through = {"AWS_ENDPOINT": f"http://127.0.0.1:{proxy.port}"}
        api = cluster.node("api", **through).client(patience_s=300)
        cluster.node("worker", **through)
        cluster.nodes[0].stop()
        proxy.errors, proxy.stalls, proxy.cuts, proxy.wrong = 0.2, 0.01, 0.05, 0.1
        jobs = []
        for seed in range(options.uploads):
            jobs.append(api.submit(api.upload(take(12, seed=seed))["id"], FIXED)["id"])
        for job in jobs:
            require(api.wait(job)["state"] == "succeeded", "a job does not succeed")
        cached = [node for node in cluster.nodes if node.process.poll() is None]
        cached[0].stop()
        shutil.rmtree(cached[0].data, ignore_errors=True)
        fresh = cluster.node("api", **through).client(patience_s=300)
        n_files = 0
        for job in jobs:
            for file in fresh.manifest(job)["files"]:
                fetch(fresh, job, file["name"])
                n_files += 1
        require(fresh.manifest(jobs[0])["files"] == expected["files"], "the first result differs from that without faults")
        proxy.errors = proxy.stalls = proxy.cuts = proxy.wrong = 0.0
        check_objects(cluster)
        return f"{proxy.counts}; {len(jobs)} uploads and results, {n_files} files read by another node, every digest right"
    finally:
        cluster.remove()


def fetch(client, job, name):
    """A damaged copy is answered with an error, never sent; `artifact` compares the digest."""
    for _ in range(20):
        try:
            return client.artifact(job, name)
        except wandless.Problem as problem:
            require(problem.status >= 500, f"{name}: {problem}")
    raise wandless.Problem(500, {"title": f"{name} cannot be read in 20 tries"})


def cut_off(options):
    """A worker that loses PostgreSQL, or the object store, and nothing else: its job ends once."""
    cluster = Cluster(options.program, options.s3)
    try:
        api = cluster.node("api").client()
        database = PostgresProxy(cluster.postgres.port)
        through = {"WANDLESS_STORE__URL": database.url("wandless")}
        store = StoreProxy(cluster.store.port) if options.s3 else None
        if store:
            through["AWS_ENDPOINT"] = f"http://127.0.0.1:{store.port}"
        cluster.node("worker", **through)
        session = api.upload(take(120, 3))["id"]
        ended = []
        for proxy in [database, store] if store else [database]:
            job = api.submit(session, FIXED)["id"]
            wait_for(lambda job=job: api.job(job)["state"] == "running", 30, "the job starts")
            if proxy is database:
                proxy.cut()
            else:
                proxy.is_cut = True
            other = cluster.node("worker")
            time.sleep(options.cut)
            if proxy is database:
                proxy.mend()
            else:
                proxy.is_cut = False
            require(api.wait(job)["state"] == "succeeded", "the job does not succeed")
            rows = cluster.postgres.ask(f"SELECT fence, result_fence FROM jobs WHERE id = '{job}'")
            require(rows[0][0] == rows[0][1], f"two claims have published: {rows}")
            ended.append(rows[0][1])
            other.stop()
        n_files, strays = check_objects(cluster)
        return f"cut off for {options.cut:.0f} s from PostgreSQL, then from the object store: published by claims {ended}; {n_files} objects right, {strays} strays"
    finally:
        cluster.remove()


def size_of(path):
    try:
        return os.path.getsize(path)
    except FileNotFoundError:
        return 0


def large_upload(options):
    """An upload is spooled to the disk: the memory of the node does not grow with it."""
    cluster = Cluster(options.program, options.s3)
    try:
        node = cluster.node("api", "--set", f"limits.max_upload_bytes={4 << 30}")
        node.client().upload(take(8))
        before, most, spooled = node.rss_mib(), [0.0], [0]
        place = os.path.join(node.data, "tmp")
        done = threading.Event()

        def watch():
            while not done.wait(0.05):
                most[0] = max(most[0], node.rss_mib())
                spooled[0] = max([spooled[0], *(size_of(os.path.join(place, name)) for name in os.listdir(place))])

        threading.Thread(target=watch, daemon=True).start()
        size = options.upload_mib << 20
        # A zip by its first bytes, so that the whole body is taken before the reader refuses it. It pauses a mebibyte before
        # its end: on a fast disk the last tenth was written and removed between two looks of `watch`.
        command = f"(printf 'PK\\003\\004'; head -c {size - (1 << 20) - 4} /dev/zero; sleep 1; head -c {1 << 20} /dev/zero) | curl -s -o /dev/null -w '%{{http_code}}' -T - -X POST -H 'Content-Type: application/zip' -H 'Transfer-Encoding:' -H 'Content-Length: {size}' {node.url}/v1/sessions"
        answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True).stdout
        done.set()
        require(answer in ("400", "413", "422"), f"the upload was answered {answer}")
        require(spooled[0] >= 0.9 * size, f"{spooled[0] >> 20} MiB of {options.upload_mib} were spooled, so nothing was measured")
        growth = most[0] - before
        require(growth <= 64, f"the node grew by {growth:.0f} MiB")
        require(until(lambda: not os.listdir(place), 10), f"left in tmp: {os.listdir(place)}")
        return f"{options.upload_mib} MiB: the node grew by {growth:.0f} MiB"
    finally:
        cluster.remove()
