"""Repetition of requests, against a server that fails on purpose."""

import hashlib
import http.server
import json
import threading
import time

import httpx
import pytest

from wandless import Client, Problem, check_webhook
from wandless.__main__ import main
from wandless._operations import Answer, artifact

SESSION = {"id": "session_1"}


class Flaky(http.server.BaseHTTPRequestHandler):
    """Answers as the list says, then with a session; `close` ends the connection without an answer."""

    plan: list = []
    seen: list = []

    def do_POST(self):
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.seen.append((self.path, self.headers.get("Idempotency-Key"), body))
        step = self.plan.pop(0) if self.plan else 200
        if step == "close":
            self.connection.close()
            return
        text = json.dumps(SESSION if step == 200 else {"code": "busy", "detail": "wait", "remedy": "wait"}).encode()
        self.send_response(step)
        self.send_header("Content-Length", str(len(text)))
        self.send_header("Retry-After", "0.01")
        self.end_headers()
        self.wfile.write(text)

    do_DELETE = do_POST

    def log_message(self, *_):
        pass


@pytest.fixture()
def flaky():
    Flaky.plan, Flaky.seen = [], []
    listener = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Flaky)
    threading.Thread(target=listener.serve_forever, daemon=True).start()
    with Client(f"http://127.0.0.1:{listener.server_port}", patience_s=5) as client:
        yield client
    listener.shutdown()


def test_upload_is_repeated_as_a_whole(flaky):
    Flaky.plan = [503, "close", 429]
    content = json.dumps({"name": "x" * 500_000}).encode()
    assert flaky.upload(content) == SESSION
    assert [body for _, _, body in Flaky.seen] == [content] * 4


def test_repeated_submission_keeps_its_idempotency_key(flaky):
    Flaky.plan = ["close", 503]
    flaky.submit("session_1", {"people": 2})
    keys = {key for _, key, _ in Flaky.seen}
    assert len(Flaky.seen) == 3 and len(keys) == 1 and None not in keys


def test_refusals_are_not_repeated(flaky):
    Flaky.plan = [422]
    with pytest.raises(Problem) as refusal:
        flaky.submit("session_1")
    assert refusal.value.status == 422 and len(Flaky.seen) == 1


def test_deletion_whose_answer_was_lost_has_succeeded(flaky):
    Flaky.plan = ["close", 404]
    flaky.delete_job("job_1")
    Flaky.plan = [503, 404]
    with pytest.raises(Problem):
        flaky.delete_job("job_2")


def test_forged_signature_of_any_characters_is_refused():
    headers = {"webhook-id": "a", "webhook-timestamp": str(int(time.time())), "webhook-signature": "v1,\xe4 \udcff"}
    assert not check_webhook("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", headers, b"")


@pytest.mark.parametrize("words, status, text", [
    (["nowhere", "out"], 2, "nowhere does not exist"),
    ([".", "out", "--options", "{"], 2, "not JSON"),
    ([".", "out", "--server", "http://127.0.0.1:1"], 1, "refused"),
])
def test_command_names_the_mistake_in_a_line(words, status, text, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["wandless-submit", *words])
    monkeypatch.setattr(main.__globals__["Client"].__init__, "__defaults__", ("http://127.0.0.1:8700", None, 5.0, 0.0))
    try:
        found = main()
    except SystemExit as end:
        found = end.code
    assert found == status and text in capsys.readouterr().err


def test_request_that_cannot_be_sent_is_not_repeated(flaky):
    start = time.monotonic()
    for server, key in (("127.0.0.1:8700", None), (str(flaky._http.base_url), "a\nb")):
        with Client(server, key) as client, pytest.raises(httpx.TransportError):
            client.job("job_1")
    assert time.monotonic() - start < 5


def test_patience_ends(flaky):
    flaky.patience_s = 0.2
    Flaky.plan = [503] * 1000
    with pytest.raises(Problem):
        flaky.submit("session_1")


def test_weak_tag_of_a_proxy_still_names_the_digest():
    body = b"bytes"
    operation = artifact("job_1", "people.json", patience_s=0)
    next(operation)
    with pytest.raises(StopIteration) as end:
        operation.send(Answer(200, {"ETag": f'W/"{hashlib.sha256(body).hexdigest()}"'}, body))
    assert end.value.value == body
