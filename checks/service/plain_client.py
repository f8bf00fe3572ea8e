"""The client of the service checks: standard library only, one connection per request, every step open to a check.

Programs use the package in `clients/python`.
"""

import base64
import hashlib
import hmac
import http.client
import json
import os
import random
import time
import urllib.parse
import uuid

FINAL = ("succeeded", "failed", "canceled", "dead")


class Problem(Exception):
    """An error answer: `status`, `code`, `detail`, `remedy`, and `document`, the whole problem document."""

    def __init__(self, status, document):
        self.status = status
        self.document = document
        self.code = document.get("code", "")
        self.detail = document.get("detail", "")
        self.remedy = document.get("remedy", "")
        super().__init__(f"{status} {self.code}: {self.detail}; {self.remedy}")


class JobFailed(Exception):
    """A job that ended without a result; `job` is the job document."""

    def __init__(self, job):
        self.job = job
        super().__init__(f"job {job['id']} {job['state']}: {job.get('error')}")


class Client:
    """Client of one service. It is not thread-safe: create one client per thread."""

    def __init__(self, server, key=None, timeout_s=120.0, patience_s=60.0):
        """`patience_s`: how long requests are retried while the service restarts or is busy."""
        self.url = urllib.parse.urlsplit(server)
        self.key = key
        self.timeout_s = timeout_s
        self.patience_s = patience_s

    # Sessions

    def upload(self, source):
        """Uploads a session: the path of a zip, JSON or NDJSON file, or a dict."""
        if isinstance(source, dict):
            return self.json("POST", "/v1/sessions", body=json.dumps(source).encode(), media_type="application/json")
        with open(source, "rb") as file:
            start = file.read(2)
        media_type = "application/zip" if start == b"PK" else "application/json"
        if str(source).endswith((".ndjson", ".jsonl")):
            media_type = "application/x-ndjson"
        return self.json("POST", "/v1/sessions", body=source, media_type=media_type)

    def inspect(self, session):
        """Inspects a session before it is solved."""
        return self.json("GET", f"/v1/sessions/{session}/inspection")

    def sessions(self):
        """Iterates over all sessions, newest first."""
        return self.pages("/v1/sessions", "sessions")

    def delete_session(self, session):
        self.request("DELETE", f"/v1/sessions/{session}")

    # Jobs

    def submit(self, session, options=None, labels=None, priority=0, webhook=None, key=None):
        """Submits a job. A repetition with the same `key` returns the same job; without `key` a new one is generated."""
        body = {"session": session, "options": options or {}, "labels": labels or {}, "priority": priority}
        if webhook is not None:
            body["webhook"] = {"url": webhook}
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        text = json.dumps(body).encode()
        return self.json("POST", "/v1/jobs", body=text, media_type="application/json", headers=headers)

    def job(self, job, wait_s=0, etag=None):
        """Returns the job after a change, or after `wait_s` at the latest. None if it still has the given `etag`."""
        headers = {"If-None-Match": etag} if etag else {}
        path = f"/v1/jobs/{job}" + (f"?wait={wait_s}" if wait_s else "")
        answer = self.request("GET", path, headers=headers)
        return None if answer.status == 304 else json.loads(answer.body)

    def jobs(self, state=None, label=None):
        """Iterates over jobs, newest first."""
        query = {key: value for key, value in (("state", state), ("label", label)) if value}
        return self.pages("/v1/jobs", "jobs", query)

    def wait(self, job, on_change=None, wait_s=30):
        """Follows a job to its end and returns it; raises `JobFailed` if it has no result."""
        while True:
            now = self.job(job, wait_s=wait_s)
            if on_change:
                on_change(now)
            if now["state"] == "succeeded":
                return now
            if now["state"] in FINAL:
                raise JobFailed(now)

    def events(self, job, last_event_id=None):
        """Iterates over the events of a job, pairs of name and data, until it ends."""
        headers = {"Last-Event-ID": str(last_event_id)} if last_event_id else {}
        connection, answer = self.open("GET", f"/v1/jobs/{job}/events", None, headers)
        try:
            if answer.status != 200:
                raise problem(answer.status, answer.read())
            name, data = "message", []
            for line in answer:
                line = line.decode().rstrip("\n")
                if line.startswith("event:"):
                    name = line[6:].strip()
                elif line.startswith("data:"):
                    data.append(line[5:].strip())
                elif not line and data:
                    yield name, json.loads("\n".join(data))
                    name, data = "message", []
        finally:
            connection.close()

    def cancel(self, job):
        return self.json("POST", f"/v1/jobs/{job}/cancel")

    def delete_job(self, job):
        self.request("DELETE", f"/v1/jobs/{job}")

    # Results

    def manifest(self, job):
        return self.json("GET", f"/v1/jobs/{job}/result")

    def artifact(self, job, name):
        """Returns the bytes of one file of a result, after a check of its digest."""
        answer = self.request("GET", f"/v1/jobs/{job}/artifacts/{urllib.parse.quote(name)}")
        if hashlib.sha256(answer.body).hexdigest() != answer.headers.get("ETag", "").strip('"'):
            raise ValueError(f"{name}: the received bytes do not have the published digest")
        return answer.body

    def download(self, job, folder):
        """Writes all files of a result into `folder`."""
        names = [file["name"] for file in self.manifest(job)["files"]] + ["manifest.json"]
        for name in names:
            path = os.path.join(folder, *name.split("/"))
            if os.path.relpath(path, folder).startswith(".."):
                raise ValueError(f"{name}: the path of the file leaves the folder")
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, "wb") as file:
                file.write(self.artifact(job, name))
        return names

    # Webhooks

    def webhook_secret(self):
        return self.json("GET", "/v1/webhook-secret")["secret"]

    def rotate_webhook_secret(self):
        """Replaces the secret; calls are signed with both for 24 hours."""
        return self.json("POST", "/v1/webhook-secret")["secret"]

    def deliveries(self, job):
        return self.json("GET", f"/v1/jobs/{job}/deliveries")["deliveries"]

    def redeliver(self, job, delivery):
        return self.json("POST", f"/v1/jobs/{job}/deliveries/{delivery}/redeliver")

    # Requests

    def pages(self, path, items, query=None):
        query = dict(query or {})
        while True:
            page = self.json("GET", path + ("?" + urllib.parse.urlencode(query) if query else ""))
            yield from page[items]
            if page["next_page_token"] is None:
                return
            query["page_token"] = page["next_page_token"]

    def json(self, method, path, **request):
        return json.loads(self.request(method, path, **request).body)

    def request(self, method, path, body=None, media_type=None, headers=None):
        """Sends a request; retries it while the service restarts or is busy, if a repetition is harmless."""
        headers = dict(headers or {})
        if media_type:
            headers["Content-Type"] = media_type
        repeatable = method in ("GET", "DELETE") or "Idempotency-Key" in headers or path == "/v1/sessions"
        deadline = time.monotonic() + self.patience_s
        wait_s = 0.2
        while True:
            try:
                answer = self.once(method, path, body, headers)
                if answer.status < 400:
                    return answer
                fault = problem(answer.status, answer.body)
                if answer.status not in (429, 503) or time.monotonic() > deadline:
                    raise fault
                wait_s = float(answer.headers.get("Retry-After", wait_s))
            except (OSError, http.client.HTTPException):
                if not repeatable or time.monotonic() > deadline:
                    raise
            time.sleep(min(wait_s, max(0.0, deadline - time.monotonic())) * random.uniform(0.5, 1.0))
            wait_s = min(2 * wait_s, 5.0)

    def once(self, method, path, body, headers):
        connection, answer = self.open(method, path, body, headers)
        try:
            return Answer(answer.status, answer.headers, answer.read())
        finally:
            connection.close()

    def open(self, method, path, body, headers):
        kind = http.client.HTTPSConnection if self.url.scheme == "https" else http.client.HTTPConnection
        connection = kind(self.url.hostname, self.url.port, timeout=self.timeout_s)
        if self.key:
            headers = {**headers, "Authorization": f"Bearer {self.key}"}
        path = self.url.path.rstrip("/") + path
        if isinstance(body, (str, os.PathLike)):
            with open(body, "rb") as file:
                headers = {**headers, "Content-Length": str(os.path.getsize(body))}
                try:
                    connection.request(method, path, body=file, headers=headers)
                except BrokenPipeError:
                    pass  # refused before the whole body was sent: the answer has the reason
                return connection, connection.getresponse()
        try:
            connection.request(method, path, body=body, headers=headers)
        except BrokenPipeError:
            pass  # refused before the whole body was sent: the answer has the reason
        return connection, connection.getresponse()


class Answer:
    def __init__(self, status, headers, body):
        self.status, self.headers, self.body = status, headers, body


def problem(status, body):
    try:
        return Problem(status, json.loads(body))
    except ValueError:
        return Problem(status, {"detail": body[:200].decode("utf-8", "replace")})


def check_webhook(secret, headers, body, tolerance_s=300):
    """True if a webhook was signed with `secret` and is recent. `headers`: any mapping; `body`: the bytes as received."""
    headers = {key.lower(): value for key, value in headers.items()}
    key = base64.b64decode(secret.removeprefix("whsec_") if hasattr(secret, "removeprefix") else secret[6:])
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    expected = "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    fresh = abs(time.time() - int(headers["webhook-timestamp"])) <= tolerance_s
    given = headers.get("webhook-signature", "").split()
    return fresh and any(hmac.compare_digest(expected, signature) for signature in given)
