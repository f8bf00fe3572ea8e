"""Row of `scale.py`: ten thousand short jobs while nodes are killed several times a second and PostgreSQL dies four times.

    python3 checks/service/scale.py --program target/failpoints/release/wandless --row storm --jobs 10000 --kills 3000 --workers 8

Needs a program with the feature `failpoints`, which simulates jobs. The jobs are submitted during the storm, each under its own
Idempotency-Key, so that an answer that a kill has cut off is asked for again.
"""

import os
import random
import shutil
import threading
import time

from cluster import Cluster, wait_for
from growth import result_folder
from harness import Failed, require, until, take, wandless
from states import FIXED, check_objects, final_states, manifests_differ, sweep

#: What a result needs at least; few objects a job, so that ten thousand jobs take minutes.
NEEDED = {"report.json", "cameras.json", "people.json"}

#: Times that PostgreSQL is killed, spread over the kills.
OUTAGES = 4

#: At several kills a second a job can lose ten workers in a row, after which it would be `failed` with `worker_lost`.
MAX_LOSSES = "jobs.max_losses=1000"

#: Seconds between two lines about the progress.
REPORT_S = 30.0


class Storm:
    """Nodes, their killer, and the submitters."""

    def __init__(self, options, cluster, folder):
        self.options, self.cluster, self.dice = options, cluster, random.Random(options.seed)
        simulated = {"WANDLESS_SIMULATED_JOB": f"{options.job_ms}:{folder}"}
        self.api = [cluster.node("api", "--set", MAX_LOSSES) for _ in range(2)]
        self.workers = [cluster.node("worker", "--set", MAX_LOSSES, **simulated) for _ in range(options.workers)]
        self.session = self.api[0].client().upload(take(8))["id"]
        self.up, self.lock = set(cluster.nodes), threading.Lock()
        self.ids, self.faults, self.n_kills, self.n_outages, self.starts = {}, [], 0, 0, 0
        self.over = threading.Event()

    def submit(self, part, parts):
        """Submits each job of this part once, through both API nodes in turn."""
        try:
            clients = [node.client(patience_s=600) for node in self.api]
            for n in range(part, self.options.jobs, parts):
                self.ids[n] = clients[n // parts % 2].submit(self.session, FIXED, key=f"storm {n}")["id"]
        except (wandless.Problem, OSError) as fault:
            self.faults.append(f"a job was not accepted: {fault}")

    def kill(self):
        """Kills a node that is up, mostly a worker, and has it started anew."""
        with self.lock:
            chosen = self.workers if self.dice.random() < 0.85 else self.api
            victims = [node for node in chosen if node in self.up]
            if not victims:
                return
            victim = self.dice.choice(victims)
            self.up.discard(victim)
        victim.kill()
        self.n_kills += 1
        threading.Thread(target=self.revive, args=(victim,), daemon=True).start()

    def revive(self, node):
        """Starts a node until it stays: without PostgreSQL it ends, and its supervisor tries again."""
        while not self.over.is_set():
            self.starts += 1
            shutil.rmtree(node.data, ignore_errors=True)
            if node.start() is not None:
                with self.lock:
                    self.up.add(node)
                return
            time.sleep(0.5)

    def database_dies(self):
        self.cluster.postgres.kill()
        self.n_outages += 1
        time.sleep(self.dice.uniform(1.0, 5.0))
        self.cluster.postgres.start()

    def run(self):
        """Until all jobs have ended; kills no more than asked for."""
        submitters = [threading.Thread(target=self.submit, args=(part, 4), daemon=True) for part in range(4)]
        for thread in submitters:
            thread.start()
        start, reported = time.monotonic(), 0.0
        while self.n_kills < self.options.kills and not (self.faults or self.has_ended()):
            until_next = time.monotonic() + self.dice.expovariate(1.0 / self.options.every)
            self.kill()
            if self.n_kills * (OUTAGES + 1) >= (self.n_outages + 1) * self.options.kills and self.n_outages < OUTAGES:
                self.database_dies()
            if time.monotonic() - reported > REPORT_S:
                reported = time.monotonic()
                print(f"  {reported - start:.0f} s: {self.n_kills} kills, {len(self.ids)} accepted, {states_or_none(self.cluster)}", flush=True)
            time.sleep(max(0.0, until_next - time.monotonic()))
        stormed = time.monotonic() - start
        for thread in submitters:
            thread.join(900)
        require(not self.faults, "; ".join(self.faults[:3]))
        wait_for(self.has_ended, 3600, f"all jobs end, now {states_or_none(self.cluster)}")
        return stormed, time.monotonic() - start

    def has_ended(self):
        """Whether all jobs have succeeded, or one has ended in another way."""
        states = states_or_none(self.cluster) or {}
        return states == {"succeeded": self.options.jobs} or bool({"failed", "dead", "canceled"} & set(states))


def states_or_none(cluster):
    """Numbers of jobs by state; None while the database is away."""
    try:
        return final_states(cluster)
    except Failed:
        return None


def storm(options):
    """Nodes are killed several times a second: every job ends once, with its own files, and the counters are exact."""
    folder = result_folder(options)
    for name in os.listdir(folder):
        if name not in NEEDED:
            path = os.path.join(folder, name)
            shutil.rmtree(path) if os.path.isdir(path) else os.remove(path)
    cluster = Cluster(options.program, options.s3)
    try:
        running = Storm(options, cluster, folder)
        stormed, total = running.run()
        running.over.set()
        require(until(lambda: len(running.up) == len(cluster.nodes), 60), "a killed node does not start")
        states, ask = final_states(cluster), cluster.postgres.ask
        require(states == {"succeeded": options.jobs}, f"states: {states}; {ask('SELECT id, error FROM jobs WHERE error IS NOT NULL LIMIT 3')}")
        require(len(set(running.ids.values())) == options.jobs, "two keys have one job")
        unknown = set(running.ids.values()) ^ {row[0] for row in ask("SELECT id FROM jobs")}
        require(not unknown, f"{len(unknown)} jobs were accepted and are not there, or are there twice")
        crashes = ask("SELECT count(*) FROM jobs WHERE crashes > 0 OR attempt > 1")
        require(crashes == [["0"]], "a kill was counted as a crash")
        require(manifests_differ(cluster) == 1, "results differ")
        fences, worst = ask("SELECT CAST(sum(fence) AS BIGINT), max(losses) FROM jobs")[0]
        n_files, n_strays = check_objects(cluster)
        client = running.api[0].client()
        sample = {client.artifact(job, "people.json") for job in running.dice.sample(sorted(running.ids.values()), min(100, options.jobs))}
        require(len(sample) == 1, "files differ")
        swept = sweep(cluster)
        return (f"{options.jobs} jobs, {running.n_kills} kills in {stormed:.0f} s, PostgreSQL died {running.n_outages} times, {total:.0f} s to the last "
                f"end: 0 lost, 0 doubled; fences {fences}, at most {worst} losses of a job; {n_files} objects right, {n_strays} strays, "
                f"{swept} swept; counters exact")
    finally:
        cluster.remove()
        shutil.rmtree(folder, ignore_errors=True)
