"""Shared parts of the service checks: a service under test, small sessions, and a list of found faults."""

import argparse
import glob
import hashlib
import http.client
import json
import math
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import plain_client as wandless  # noqa: E402


def arguments(description, **counts):
    """Parses the arguments of a check: the program, a seed, and the number of repetitions."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--program", default="target/release/wandless")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--keep", action="store_true", help="keep the data folder even if the check passes")
    for name, default in counts.items():
        parser.add_argument("--" + name.replace("_", "-"), type=type(default), default=default)
    found = parser.parse_args()
    print(f"seed {found.seed}", flush=True)
    return found


def faketime_library():
    """The library that shifts the clock of a program, to be preloaded; None where it is not installed."""
    return next(iter(glob.glob("/usr/lib/*/faketime/libfaketime.so.1")), None)


def take(n_frames=10, n_cameras=2, seed=0):
    """A session of one walking person in front of known cameras, as one JSON document."""
    cameras, poses = [], {}
    turn = random.Random(seed).uniform(0.0, 6.0)
    heights = [1.6, 1.62, 1.62, 1.6, 1.6, 1.4, 1.4, 1.1, 1.1, 0.9, 0.9, 0.9, 0.9, 0.5, 0.5, 0.1, 0.1]
    for i in range(n_cameras):
        angle = 0.4 + 1.5 * i
        center = [4 * math.cos(angle), 1.5, 4 * math.sin(angle)]
        ahead = unit([-center[0], 1.0 - center[1], -center[2]])
        right = unit(cross(ahead, [0, 1, 0]))
        rotation = [right, cross(ahead, right), ahead]
        translation = [-dot(row, center) for row in rotation]
        cameras.append({"id": f"cam{i}", "width": 1280, "height": 720, "K": [[900, 0, 640], [0, 900, 360], [0, 0, 1]],
                        "dist": [0, 0, 0, 0, 0], "R": rotation, "t": translation})
        frames = []
        for frame in range(n_frames):
            heading = turn + 0.8 * frame / 25
            keypoints = []
            for joint, y in enumerate(heights):
                side = 0.2 if joint % 2 else -0.2
                point = [0.9 * math.cos(heading) + side * math.sin(heading), y, 0.9 * math.sin(heading) - side * math.cos(heading)]
                seen = [dot(row, point) + t for row, t in zip(rotation, translation)]
                keypoints.append([round(640 + 900 * seen[0] / seen[2], 2), round(360 + 900 * seen[1] / seen[2], 2), 0.9])
            frames.append({"frame": frame, "people": [{"track_id": None, "keypoints": keypoints}]})
        poses[f"cam{i}"] = {"frames": frames}
    return {"name": f"take {seed}", "fps": 25, "n_frames": n_frames, "keypoint_convention": "coco17", "up_axis": "y",
            "cameras": cameras, "poses": poses}


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a):
    length = math.sqrt(dot(a, a))
    return [x / length for x in a]


class Service:
    """A `wandless serve` process on a data folder; can be restarted any number of times."""

    def __init__(self, program, data=None, words=(), environment=None, prefix=()):
        self.program, self.words, self.prefix = program, list(words), list(prefix)
        self.data = data or tempfile.mkdtemp(prefix="wandless-check-")
        self.environment = {**os.environ, "WANDLESS_LOG": "error", **(environment or {})}
        self.process, self.port = None, None

    def start(self, **environment):
        """Starts the service and waits for its address; returns the seconds this took, or None if the service exited."""
        start = time.monotonic()
        listen = f"127.0.0.1:{self.port or 0}"
        command = [*self.prefix, self.program, "serve", "--listen", listen, "--data", self.data, *self.words]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                        env={**self.environment, **environment}, text=True)
        self.stderr = []
        threading.Thread(target=lambda process: self.stderr.extend(process.stderr), args=(self.process,), daemon=True).start()
        line = self.process.stdout.readline()
        if "http://" not in line:
            self.process.wait()
            time.sleep(0.05)
            print("did not start:", "".join(self.stderr).strip(), flush=True)
            return None
        self.port = int(line.rsplit(":", 1)[1])
        return time.monotonic() - start

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def client(self, **options):
        return wandless.Client(self.url, **options)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def stop(self):
        """Stops the service with SIGTERM; returns exit code and seconds."""
        start = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(timeout=40)
        return code, time.monotonic() - start

    def rss_mib(self):
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))

    def metrics(self):
        with urllib.request.urlopen(self.url + "/metrics", timeout=30) as answer:
            lines = answer.read().decode().splitlines()
        return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if not line.startswith("#")}

    def integrity(self):
        """Result of SQLite's integrity check on a copy of the stopped service's database."""
        with tempfile.TemporaryDirectory() as folder:
            for name in ("wandless.db", "wandless.db-wal"):
                if os.path.exists(os.path.join(self.data, name)):
                    shutil.copy(os.path.join(self.data, name), folder)
            with sqlite3.connect(os.path.join(folder, "wandless.db")) as database:
                return database.execute("PRAGMA integrity_check").fetchone()[0]

    def remove(self):
        shutil.rmtree(self.data, ignore_errors=True)


class Faults:
    """Collects the faults that a check finds, and exits with 1 if there are any."""

    def __init__(self):
        self.found = []

    def require(self, truth, fault):
        if not truth:
            self.found.append(fault)
            print("FAULT", fault, flush=True)

    def end(self, service=None, keep=False):
        if service:
            if self.found or keep:
                print("data folder kept:", service.data)
            else:
                service.remove()
        print("FAILED" if self.found else "passed", flush=True)
        sys.exit(1 if self.found else 0)


class Failed(Exception):
    """What a row of a check has found."""


def require(truth, what):
    if not truth:
        raise Failed(what)


def until(truth, seconds, pause=0.02):
    """Whether `truth` holds within `seconds`; asked again after each pause."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if truth():
            return True
        time.sleep(pause)
    return truth()


def percentile(values, share):
    values = sorted(values)
    return values[min(len(values) - 1, int(share * len(values)))]


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def get(port, path, connection=None, headers=None):
    """One GET request, optionally on an open connection; returns status and seconds."""
    connection = connection or http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    start = time.monotonic()
    connection.request("GET", path, headers=headers or {})
    answer = connection.getresponse()
    answer.read()
    return answer.status, time.monotonic() - start


__all__ = ["Faults", "Service", "arguments", "get", "json", "percentile", "sha256", "take", "wandless"]
