"""Client of the service, with Python's standard library alone; no Blender."""

import http.client
import io
import json
import os
import time
import urllib.error
import urllib.request
import uuid
import zipfile
from pathlib import Path

FINAL = ("succeeded", "failed", "canceled", "dead")
WAIT_S = 10  # the service holds a request for the state of a job so long
PATIENCE_S = 120.0  # a job is followed so long without an answer: a restart of the service, a lost network
RETRY_S = 2.0
BUSY = (429, 502, 503, 504)  # of a proxy, too, whose service restarts


class ServiceError(Exception):
    """The service refused a request or does not answer; the message says what to do."""


class Unanswered(ServiceError):
    """The service does not answer, or is busy: the same request can succeed later."""


def zipped(session):
    """A session as the service takes it: a folder is packed, without ground truth and hidden files."""
    session = Path(session)
    if session.is_file():
        data = session.read_bytes()
        return data, "application/zip" if data[:2] == b"PK" else "application/json"
    if not session.is_dir():
        raise ServiceError(f"{session} does not exist; choose the folder of a session")
    packed = io.BytesIO()
    # Files without a time of their own have that of 1970, which a zip cannot state.
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for path in sorted(session.rglob("*")):
            name = path.relative_to(session)
            if path.is_file() and name.parts[0] != "gt" and not any(part.startswith(".") for part in name.parts):
                archive.write(path, name.as_posix())
    return packed.getvalue(), "application/zip"


class Service:
    """One service and the key for it."""

    def __init__(self, server, key=""):
        self.server, self.key = server.rstrip("/"), key

    def _request(self, method, path, body=None, headers=None):
        request = urllib.request.Request(self.server + path, data=body, method=method, headers=dict(headers or {}))
        if self.key:
            request.add_header("Authorization", f"Bearer {self.key}")
        try:
            with urllib.request.urlopen(request, timeout=WAIT_S + 330) as answer:
                return answer.read()
        except urllib.error.HTTPError as error:
            raise (Unanswered if error.code in BUSY else ServiceError)(explained(error)) from None
        except (OSError, http.client.HTTPException) as error:  # also a connection that ends within the answer
            reason = getattr(error, "reason", None) or error
            text = f"{self.server} does not answer ({reason}); check the address and that the service runs"
            raise Unanswered(text) from None

    def _json(self, method, path, document=None):
        body, headers = None, {}
        if document is not None:
            headers = {"Content-Type": "application/json", "Idempotency-Key": str(uuid.uuid4())}
            body = json.dumps(document).encode()
        return json.loads(self._request(method, path, body, headers))

    def upload(self, session):
        """Uploads a session; returns its document."""
        body, media_type = zipped(session)
        return json.loads(self._request("POST", "/v1/sessions", body, {"Content-Type": media_type}))

    def submit(self, session, options):
        """Submits a job; returns its document."""
        return self._json("POST", "/v1/jobs", {"session": session, "options": options})

    def job(self, job, wait_s=0):
        """A job, at once or after a change."""
        return self._json("GET", f"/v1/jobs/{job}?wait={wait_s}")

    def next_state(self, job, is_stopped, on_silence):
        """The job after a change; asks again for a while if the service does not answer. `on_silence` receives why."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self.job(job, WAIT_S)
            except Unanswered as error:
                if time.monotonic() > deadline or is_stopped.wait(RETRY_S):
                    raise ServiceError(f"{error}; the job {job} goes on in the service") from None
                on_silence(f"{error}; trying again")

    def cancel(self, job):
        return self._json("POST", f"/v1/jobs/{job}/cancel", {})

    def download(self, job, folder):
        """Writes all files of a result into `folder`, with the skinned people."""
        self._json("POST", f"/v1/jobs/{job}/exports", {"exports": ["glb"]})
        archive = zipfile.ZipFile(io.BytesIO(self._request("GET", f"/v1/jobs/{job}/archive")))
        root = os.path.realpath(folder)
        for name in archive.namelist():
            if os.path.commonpath([root, os.path.realpath(os.path.join(root, name))]) != root:
                raise ServiceError(f"the archive names a file outside of its folder: {name!r}")
        archive.extractall(root)
        return Path(root)


def explained(error):
    """The problem document of an answer in one sentence."""
    try:
        problem = json.load(error)
        return "; ".join(filter(None, [problem["detail"], problem.get("remedy")]))
    except (ValueError, KeyError, TypeError):
        return f"the service answered {error.code}"
