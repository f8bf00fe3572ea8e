"""A PostgreSQL server and an S3 server of a check, and the nodes of a service on them."""

import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time

from harness import Service, require, until

#: User that owns the server where the check runs as root: the one without rights of most systems.
UNPRIVILEGED = 65534

#: The bucket of the checks.
BUCKET = "wandless"


def find(name):
    """A program of PostgreSQL, which distributions keep outside the path; None where it is not installed."""
    folders = os.environ.get("PATH", "").split(":")
    root = "/usr/lib/postgresql"
    if os.path.isdir(root):
        folders += [f"{root}/{version}/bin" for version in sorted(os.listdir(root), key=float, reverse=True)]
    return next((path for folder in folders if os.access(path := os.path.join(folder, name), os.X_OK)), None)


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


class Postgres:
    """A server in a temporary folder. It refuses to run as root, so root starts it as another user."""

    def __init__(self, durable=True):
        self.folder = tempfile.mkdtemp(prefix="wandless-postgres-")
        self.port = free_port()
        self.user = []
        if os.getuid() == 0:
            self.user = ["setpriv", f"--reuid={UNPRIVILEGED}", "--clear-groups"]
            os.chown(self.folder, UNPRIVILEGED, -1)
        self.data = os.path.join(self.folder, "data")
        self.run("initdb", "-D", self.data, "-U", "postgres", "-A", "trust", "--no-sync")
        with open(os.path.join(self.data, "postgresql.conf"), "a") as file:
            file.write(f"listen_addresses='127.0.0.1'\nport={self.port}\nunix_socket_directories='{self.folder}'\n"
                       f"max_connections=300\nfsync={'on' if durable else 'off'}\n")
        self.start()

    def run(self, program, *words):
        done = subprocess.run([*self.user, find(program), *words], capture_output=True, text=True, cwd=self.folder)
        require(done.returncode == 0, f"{program}: {done.stderr.strip()}")

    def start(self):
        self.run("pg_ctl", "-D", self.data, "-l", os.path.join(self.folder, "log"), "-w", "-t", "60", "start")

    def kill(self):
        """Ends every process of the server without warning."""
        with open(os.path.join(self.data, "postmaster.pid")) as file:
            pid = int(file.readline())
        children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True).stdout.split()
        for one in [pid, *map(int, children)]:
            try:
                os.kill(one, signal.SIGKILL)
            except ProcessLookupError:
                pass
        until(lambda: not any(os.path.exists(f"/proc/{one}") for one in [pid, *children]), 10)

    def url(self, database):
        return f"postgres://postgres@127.0.0.1:{self.port}/{database}"

    def create(self, database):
        self.ask(f"CREATE DATABASE {database}", "postgres")

    def ask(self, statement, database="wandless"):
        """The rows of an answer, each a list of texts."""
        done = subprocess.run([find("psql"), self.url(database), "-XAtq", "-F", "\t", "-v", "ON_ERROR_STOP=1", "-c", statement],
                              capture_output=True, text=True)
        require(done.returncode == 0, f"{statement}: {done.stderr.strip()}")
        return [line.split("\t") for line in done.stdout.splitlines()]

    def remove(self):
        subprocess.run([*self.user, find("pg_ctl"), "-D", self.data, "-m", "immediate", "stop"], capture_output=True)
        shutil.rmtree(self.folder, ignore_errors=True)


class ObjectStore:
    """An S3 server, s3s-fs; without it a folder that all nodes share."""

    def __init__(self, program, bucket=BUCKET, access_key="check", secret_key="check-secret"):
        self.folder, self.bucket = tempfile.mkdtemp(prefix="wandless-objects-"), bucket
        self.process, self.environment = None, {}
        if not program:
            print("SKIPPED: S3, because s3s-fs is not installed (cargo install s3s-fs --version 0.14.1 --features binary --locked); "
                  "a shared folder is used", flush=True)
            self.url = f"file://{self.folder}"
            return
        os.mkdir(os.path.join(self.folder, bucket))
        port = free_port()
        self.command = [program, "--host", "127.0.0.1", "--port", str(port), "--access-key", access_key, "--secret-key", secret_key,
                        self.folder]
        self.environment = {"AWS_ACCESS_KEY_ID": access_key, "AWS_SECRET_ACCESS_KEY": secret_key, "AWS_REGION": "us-east-1",
                            "AWS_ENDPOINT": f"http://127.0.0.1:{port}", "AWS_ALLOW_HTTP": "true"}
        self.url = f"s3://{bucket}/service"
        self.port = port
        self.start()

    def start(self):
        self.process = subprocess.Popen(self.command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        require(until(lambda: is_open(self.port), 20), "the S3 server does not answer")

    def objects(self, folder):
        """Path by key below a folder of the store."""
        root = os.path.join(self.folder, self.bucket, "service") if self.process else self.folder
        found = {}
        for place, _, names in os.walk(os.path.join(root, folder)):
            for name in names:
                path = os.path.join(place, name)
                found[os.path.relpath(path, root)] = path
        return found

    def remove(self):
        if self.process:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def is_open(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Cluster:
    """A database, an object store, and nodes of given roles."""

    def __init__(self, program, s3_program=None, beat_s=0.5, lease_s=3.0, durable=True):
        self.program = program
        self.postgres, self.store = Postgres(durable), ObjectStore(s3_program)
        self.postgres.create("wandless")
        self.words = ["--set", f"worker.beat_s={beat_s}", "--set", f"worker.lease_s={lease_s}"]
        self.lease_s = lease_s
        self.nodes = []

    def node(self, role, *words, prefix=(), **environment):
        """A started node."""
        settings = {"WANDLESS_STORE__URL": self.postgres.url("wandless"), "WANDLESS_BLOBS__URL": self.store.url}
        node = Service(self.program, words=["--role", role, *self.words, *words],
                       environment={**settings, **self.store.environment, **environment}, prefix=prefix)
        require(node.start() is not None, f"a node of the role {role} does not start")
        self.nodes.append(node)
        return node

    def restart(self, node):
        """Starts a killed node anew, as a supervisor does on an empty machine."""
        shutil.rmtree(node.data, ignore_errors=True)
        require(node.start() is not None, "a killed node does not start")

    def leader(self):
        """Process id of the server's connection of the leader; None without one."""
        rows = self.postgres.ask("SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND granted AND objid = 2002873956")
        return rows[0][0] if rows else None

    def counters_differ(self):
        """The tenants whose counters are not those of their jobs, and the totals if they are not those of all jobs."""
        states = ["queued", "running", "canceling", "succeeded", "failed", "canceled", "dead"]
        kept = " || ',' || ".join(f"n_{state}" for state in states)
        counted = " || ',' || ".join(f"(SELECT count(*) FROM jobs WHERE tenant = name AND state = '{state}')" for state in states)
        totals = " || ',' || ".join(f"sum(n_{state})" for state in states)
        jobs = " || ',' || ".join(f"(SELECT count(*) FROM jobs WHERE state = '{state}')" for state in states)
        return self.postgres.ask(f"SELECT name, {kept}, {counted} FROM tenants WHERE ({kept}) <> ({counted}) UNION ALL"
                                 f" SELECT 'totals', {totals}, {jobs} FROM job_totals HAVING ({totals}) <> ({jobs})")

    def remove(self):
        for node in self.nodes:
            if node.process and node.process.poll() is None:
                node.kill()
            node.remove()
        self.store.remove()
        self.postgres.remove()


def wait_for(truth, seconds, what, pause=0.02):
    """Fails unless `truth` holds within `seconds`; returns the time that it took."""
    start = time.monotonic()
    require(until(truth, seconds, pause), f"{what}: not within {seconds} s")
    return time.monotonic() - start
