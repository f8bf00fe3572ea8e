"""The receiver with the real service and client libraries, against stubs of Kitsu and ShotGrid that check the calls.

    WANDLESS=target/release/wandless pytest clients/hooks/tests
"""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from email.message import Message
from email.parser import BytesParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
import wandless

HERE = Path(__file__).resolve().parent
PROGRAM = os.path.abspath(os.environ["WANDLESS"])
TASK, STATUS = "5f0f3a5e-6f0b-4b52-9a36-0a7e0a4f7c11", "0a6c9f1e-3f53-4a39-8f0b-4ac2a5d7b922"  # Kitsu's ids are UUIDs


def parts_of(handler, body):
    """The parts of a form by name."""
    head = f"Content-Type: {handler.headers['Content-Type']}\r\n\r\n".encode()
    message = BytesParser().parsebytes(head + body)
    named = [(part.get_param("name", header="content-disposition"), part) for part in message.get_payload()]
    return {name: part for name, part in named if isinstance(part, Message)}


class Stub:
    """A server that keeps every call and answers with what `answers(method, path, body, handler)` returns."""

    def __init__(self, answers):
        self.calls = []
        stub = self

        class Handler(BaseHTTPRequestHandler):
            def answer(self):
                body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
                stub.calls.append((self.command, self.path, body, self))
                status, document = answers(self.command, self.path, body)
                data = document if isinstance(document, bytes) else json.dumps(document).encode()
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            do_GET = do_POST = do_PUT = answer

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def to(self, part):
        return [call for call in self.calls if part in call[1]]


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    folder, port = tmp_path_factory.mktemp("service"), free_port()
    settings = ["--set", "webhooks.allowed_networks=['127.0.0.1']", "--set", "webhooks.first_wait_s=1"]
    command = [PROGRAM, "serve", "--data", str(folder / "data"), "--listen", f"127.0.0.1:{port}", *settings]
    running = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}"
    wait_until(lambda: is_up(url))
    simulated = [PROGRAM, "simulate", "--out", str(folder / "take"), "--people", "1", "--views", "3", "--frames", "40"]
    subprocess.run(simulated, check=True, capture_output=True)
    yield url, folder / "take"
    running.terminate()
    running.wait()


def is_up(url):
    try:
        return httpx.get(f"{url}/healthz").status_code == 200
    except httpx.HTTPError:
        return False


def wait_until(is_done, seconds=120):
    deadline = time.monotonic() + seconds
    while not is_done():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.1)


@pytest.fixture
def receiver(service, tmp_path):
    """Starts the receiver for a target; returns its URL and its output."""
    running = []

    def start(target, environment):
        secret = httpx.get(f"{service[0]}/v1/webhook-secret").json()["secret"]
        port = free_port()
        command = [sys.executable, str(HERE.parent / "publish.py"), "--to", target, "--server", service[0]]
        command += ["--folder", str(tmp_path / "published"), "--port", str(port)]
        environment = {**os.environ, **environment, "WANDLESS_WEBHOOK_SECRET": secret}
        log = (tmp_path / "log").open("w+")
        running.append(subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT))
        url = f"http://127.0.0.1:{port}"
        wait_until(lambda: url in (tmp_path / "log").read_text())
        return url, lambda: (tmp_path / "log").read_text()

    yield start
    for process in running:
        process.terminate()
        process.wait()


def solved(service, labels, webhook):
    with wandless.Client(service[0]) as client:
        session = client.upload(service[1])
        return client.wait(client.submit(session["id"], {"seed": hash(str(labels)) % 1000}, labels, webhook=webhook)["id"])


def test_kitsu_gets_a_comment_with_the_scene(service, receiver, tmp_path):
    def answers(method, path, body):
        if "/data/task-status" in path:
            return 200, [{"id": STATUS, "short_name": "wfa"}]
        return 200, {"id": "comment-1"}

    stub = Stub(answers)
    url, log = receiver("kitsu", {"KITSU_HOST": f"{stub.url}/api", "KITSU_TOKEN": "token-7"})
    job = solved(service, {"kitsu_task": TASK}, url)
    wait_until(lambda: job["id"] in log())
    assert f"{job['id']}: published" in log(), log()
    (_, _, body, handler), = stub.to("/comment")
    assert handler.path == f"/api/actions/tasks/{TASK}/comment"
    assert handler.headers["Authorization"] == "Bearer token-7"
    form = parts_of(handler, body)
    assert form["task_status_id"].get_payload() == STATUS
    assert job["quality"]["verdict"] in form["comment"].get_payload()
    files = {part.get_filename(): part.get_payload(decode=True) for part in form.values() if part.get_filename()}
    assert set(files) == {"scene.glb", "report.json"} and files["scene.glb"].startswith(b"glTF")
    assert (tmp_path / "published" / job["id"] / "manifest.json").is_file()
    other = solved(service, {"take": "9"}, url)
    wait_until(lambda: f"{other['id']}: ignored" in log())
    assert len(stub.to("/comment")) == 1


def test_shotgrid_gets_a_published_file(service, receiver, tmp_path):
    def answers(method, path, body):
        if path.startswith("/upload"):
            return 200, b"1:42\n"
        call = json.loads(body)
        if call["method_name"] == "info":
            return 200, {"results": {"version": [8, 2, 1], "s3_uploads_enabled": False}}
        if call["method_name"] == "read":
            return 200, {"results": {"entities": [], "paging_info": {"entity_count": 0, "page_count": 0}}}
        if call["method_name"] == "create":
            return 200, {"results": {"type": "PublishedFile", "id": 17}}
        return 400, {}

    stub = Stub(answers)
    environment = {"SHOTGRID_SITE": stub.url, "SHOTGRID_SCRIPT": "publisher", "SHOTGRID_KEY": "secret"}
    url, log = receiver("shotgrid", environment)
    labels = {"shotgrid_project": "70", "shotgrid_entity": "Shot:1234", "shotgrid_task": "5"}
    job = solved(service, labels, url)
    wait_until(lambda: job["id"] in log())
    assert f"{job['id']}: published" in log()
    calls = [json.loads(body) for _, path, body, _ in stub.calls if "api3" in path]
    create = next(call for call in calls if call["method_name"] == "create")
    assert create["params"][0]["script_name"] == "publisher"
    fields = {field["field_name"]: field["value"] for field in create["params"][1]["fields"]}
    assert fields["project"] == {"type": "Project", "id": 70}
    assert fields["entity"] == {"type": "Shot", "id": 1234} and fields["task"] == {"type": "Task", "id": 5}
    assert fields["path"]["url"] == (tmp_path / "published" / job["id"]).as_uri()
    (_, _, body, handler), = stub.to("/upload/upload_file")
    form = parts_of(handler, body)
    assert form["entity_id"].get_payload().strip() == "17" and b"quality" in body


def test_unsigned_calls_are_refused(receiver):
    url, log = receiver("kitsu", {"KITSU_HOST": "http://127.0.0.1:9", "KITSU_TOKEN": "x"})
    event = {"type": "job.succeeded", "data": {"id": "job_1"}}
    headers = {"webhook-id": "a", "webhook-timestamp": str(int(time.time())), "webhook-signature": "v1,AAAA"}
    assert httpx.post(url, json=event, headers=headers).status_code == 401
    assert httpx.post(url, json=event).status_code == 401
    for length in ("-1", "many"):
        with socket.create_connection(("127.0.0.1", int(url.rsplit(":", 1)[1])), timeout=10) as call:
            call.sendall(f"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: {length}\r\n\r\n".encode())
            assert b" 401 " in call.recv(100), length
    assert "job_1" not in log()


def test_failed_download_is_not_published_as_complete(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(HERE.parent))
    import publish

    class Client:
        fails = True

        def job(self, name):
            return {"id": name, "labels": {"kitsu_task": TASK}}

        def export(self, name, formats):
            pass

        def download(self, name, folder):
            Path(folder).mkdir()  # fails where an earlier download has left files
            (Path(folder) / "report.json").write_text("{}")
            if self.fails:
                raise OSError("the connection broke")

    client, published = Client(), []
    publisher = publish.Publisher(client, "kitsu", tmp_path)
    publisher.publish = lambda job, folder, report: published.append(folder)
    for _ in range(2):
        with pytest.raises(OSError):
            publisher.publish_job("job_1")
    assert published == [] and not (tmp_path / "job_1").exists()
    client.fails = False
    publisher.publish_job("job_1")
    assert published == [tmp_path / "job_1"] and [path.name for path in tmp_path.iterdir()] == ["job_1"]
