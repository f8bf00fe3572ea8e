"""Client of the service, with Python's standard library alone; no Blender."""

import io
import json
import os
import urllib.error
import urllib.request
import uuid
import zipfile
from pathlib import Path

FINAL = ("succeeded", "failed", "canceled", "dead")
WAIT_S = 10  # the service holds a request for the state of a job so long


class ServiceError(Exception):
    """The service refused a request or does not answer; the message says what to do."""


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
            return urllib.request.urlopen(request, timeout=WAIT_S + 330)
        except urllib.error.HTTPError as error:
            raise ServiceError(explained(error)) from None
        except urllib.error.URLError as error:
            reason = f"{self.server} does not answer ({error.reason}); check the address and that the service runs"
            raise ServiceError(reason) from None

    def _json(self, method, path, document=None):
        body, headers = None, {}
        if document is not None:
            headers = {"Content-Type": "application/json", "Idempotency-Key": str(uuid.uuid4())}
            body = json.dumps(document).encode()
        with self._request(method, path, body, headers) as answer:
            return json.load(answer)

    def upload(self, session):
        """Uploads a session; returns its document."""
        body, media_type = zipped(session)
        with self._request("POST", "/v1/sessions", body, {"Content-Type": media_type}) as answer:
            return json.load(answer)

    def submit(self, session, options):
        """Submits a job; returns its document."""
        return self._json("POST", "/v1/jobs", {"session": session, "options": options})

    def job(self, job, wait_s=0):
        """A job, at once or after a change."""
        return self._json("GET", f"/v1/jobs/{job}?wait={wait_s}")

    def cancel(self, job):
        return self._json("POST", f"/v1/jobs/{job}/cancel", {})

    def download(self, job, folder):
        """Writes all files of a result into `folder`, with the skinned people."""
        self._json("POST", f"/v1/jobs/{job}/exports", {"exports": ["glb"]})
        with self._request("GET", f"/v1/jobs/{job}/archive") as answer:
            archive = zipfile.ZipFile(io.BytesIO(answer.read()))
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
