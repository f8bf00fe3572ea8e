"""Row of `scale.py`: two releases side by side behind the proxy of `compose.scale.yaml`, each node restarted under load.
Needs nginx and a program with the feature `failpoints`, which can play the part of the release after itself."""

import os
import random
import shutil
import subprocess
import tempfile
import threading
import time

from cluster import Cluster, free_port, is_open, wait_for
from growth import result_folder
from harness import require, take, until, wandless
from states import FIXED, all_final, check_objects, final_states

HERE = os.path.dirname(os.path.abspath(__file__))

#: What makes a node the next release.
NEXT = {"WANDLESS_NEXT_RELEASE": "1"}


class Proxy:
    """nginx with the configuration that `compose.scale.yaml` gives it."""

    def __init__(self, program, ports):
        self.folder, self.port = tempfile.mkdtemp(prefix="wandless-proxy-"), free_port()
        os.chmod(self.folder, 0o755)
        with open(os.path.join(HERE, "..", "..", "docker", "compose.scale.yaml")) as file:
            text = file.read().split("  proxy:\n    content: |\n", 1)[1].split("\nvolumes:", 1)[0].replace("$$", "$")
        for name, port in ports.items():
            text = text.replace(f"{name}:8700", f"127.0.0.1:{port}")
        text = text.replace("listen 80;", f"listen 127.0.0.1:{self.port}; access_log off;")
        places = " ".join(f"{kind}_temp_path {self.folder}/{kind};" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
        path = os.path.join(self.folder, "nginx.conf")
        with open(path, "w") as file:
            file.write(f"daemon off; pid {self.folder}/nginx.pid; error_log {self.folder}/nginx.log; events {{}}\nhttp {{ {places}\n{text}\n}}\n")
        self.process = subprocess.Popen([program, "-p", self.folder, "-c", path], stderr=subprocess.DEVNULL)
        require(until(lambda: is_open(self.port), 20), "nginx does not answer")

    def errors(self):
        """The last lines of its log of errors."""
        with open(os.path.join(self.folder, "nginx.log")) as file:
            return [line.strip()[-200:] for line in file][-3:]

    def remove(self):
        self.process.terminate()
        self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


class Load:
    """Clients that submit and read through the proxy, and never repeat a request."""

    def __init__(self, url, session, ended, n_clients):
        """`ended`: a job that has ended, whose cancel is a POST that changes nothing."""
        self.url, self.session, self.ended = url, session, ended
        self.statuses, self.faults, self.jobs = {}, [], []
        self.over = threading.Event()
        self.threads = [threading.Thread(target=self.run, args=(seed,), daemon=True) for seed in range(n_clients)]
        for thread in self.threads:
            thread.start()

    def run(self, seed):
        client, dice = wandless.Client(self.url), random.Random(seed)
        body = wandless.json.dumps({"session": self.session, "options": FIXED}).encode()
        while not self.over.is_set():
            kind = dice.random()
            if kind < 0.03 or not self.jobs:  # as many jobs as workers of one release can end
                answer = self.ask(client, "POST", "/v1/jobs", body, {"Content-Type": "application/json"})
                if answer and answer.status == 202:
                    self.jobs.append(wandless.json.loads(answer.body)["id"])
            elif kind < 0.3:
                self.ask(client, "POST", f"/v1/jobs/{self.ended}/cancel", None, {})
            else:
                job = dice.choice(self.jobs[-200:])
                path = dice.choice([f"/v1/jobs/{job}", "/v1/jobs?page_size=20", f"/v1/jobs/{job}/artifacts/people.json", f"/v1/sessions/{self.session}"])
                self.ask(client, "GET", path, None, {})
            time.sleep(dice.expovariate(10.0))

    def ask(self, client, method, path, body, headers):
        try:
            answer = client.once(method, path, body, headers)
        except (OSError, wandless.http.client.HTTPException) as fault:
            self.faults.append(f"{method} {path}: {fault!r}")
            return None
        self.statuses[answer.status] = self.statuses.get(answer.status, 0) + 1
        if answer.status >= 500:
            self.faults.append(f"{method} {path}: {answer.status} {answer.body[:100]}")
        return answer

    def require_answers(self, proxy):
        """Fails where a request had no answer, or one of 5xx."""
        total = sum(self.statuses.values())
        require(not self.faults, f"{len(self.faults)} of {total} requests failed, {self.statuses}: {self.faults[:3]} {proxy.errors()}")

    def stop(self):
        self.over.set()
        for thread in self.threads:
            thread.join(60)


def two_releases(options):
    """Nodes of two releases work side by side, each restarted under load: no 5xx past the proxy, and no job fails for its options."""
    nginx = shutil.which("nginx") or shutil.which("/usr/sbin/nginx")
    if not nginx:
        print("SKIPPED: two releases behind a proxy, because nginx is not installed", flush=True)
        return "skipped"
    folder = result_folder(options)
    cluster, proxy, load = Cluster(options.program, options.s3), None, None
    try:
        simulated = {"WANDLESS_SIMULATED_JOB": f"200:{folder}"}
        words = ["--set", 'limits.trusted_proxies=["127.0.0.1"]', "--set", "tenants.requests_per_s=100000"]
        api = [cluster.node("api", *words) for _ in range(2)]
        workers = [cluster.node("worker", **simulated) for _ in range(3)]
        session = api[0].client().upload(take(8))["id"]
        client = api[0].client()
        ended = client.wait(client.submit(session, FIXED)["id"])["id"]
        proxy = Proxy(nginx, {"api-1": api[0].port, "api-2": api[1].port})
        load = Load(f"http://127.0.0.1:{proxy.port}", session, ended, 8)
        time.sleep(2)
        newer_tables(cluster)
        n_restarts = 0
        for _ in range(options.upgrades):
            for is_next in (True, False):  # forward, and back again
                for node in (workers[0], api[0], workers[1], api[1], workers[2]):
                    if not is_next and node is workers[2]:
                        wait_for(lambda: not waits_for_next(cluster), 120, "the jobs of the next release end before its last worker")
                    code, _ = node.stop()
                    require(code == 0, f"a node ended with {code}")
                    require(node.start(**(NEXT if is_next else {})) is not None, "a node does not start")
                    n_restarts += 1
                    time.sleep(options.between)
                    load.require_answers(proxy)
        load.stop()
        load.require_answers(proxy)
        wait_for(lambda: all_final(cluster), 300, f"all jobs end, now {final_states(cluster)}")
        unknown = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE error LIKE '%option_unknown%'")
        require(unknown == [["0"]], f"{unknown[0][0]} jobs ended with option_unknown")
        newer = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE needs = (SELECT max(needs) FROM jobs) AND options LIKE '%of_the_next_release%'")
        require(int(newer[0][0]) > 0, "no API node was the next release")
        require(set(final_states(cluster)) == {"succeeded"}, f"states: {final_states(cluster)}")
        missing = set(load.jobs) - {row[0] for row in cluster.postgres.ask("SELECT id FROM jobs")}
        require(not missing, f"{len(missing)} accepted jobs are not there")
        check_objects(cluster)
        return (f"{n_restarts} restarts, {sum(load.statuses.values())} requests {dict(sorted(load.statuses.items()))}: 0 failed; {len(load.jobs)} jobs, "
                f"{newer[0][0]} of them of the next release, all succeeded, 0 option_unknown")
    finally:
        if load:
            load.stop()
        if proxy:
            proxy.remove()
        cluster.remove()
        shutil.rmtree(folder, ignore_errors=True)


def newer_tables(cluster):
    """What `wandless migrate` of the next release does: a migration that only adds."""
    cluster.postgres.ask(
        """ALTER TABLE jobs ADD COLUMN of_the_next_release TEXT;
           INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
           VALUES (99990101000000, 'of the next release', true, '\\x00', 0)""")


def waits_for_next(cluster):
    """Whether jobs of the next release have not ended."""
    open_jobs = cluster.postgres.ask("SELECT count(*) FROM jobs WHERE state IN ('queued', 'running') AND options LIKE '%of_the_next_release%'")
    return open_jobs != [["0"]]
