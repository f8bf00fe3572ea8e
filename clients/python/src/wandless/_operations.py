"""What each method does, without network: a generator that yields requests and pauses and receives answers.

`Client` and `AsyncClient` run the same generators, one with blocking calls, the other with coroutines.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import time
import uuid
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Callable, Optional, TypeVar, Union
from urllib.parse import quote, urlencode

from ._errors import DamagedDownload, JobFailed, Problem
from ._result import Result
from ._sources import Body
from ._types import FINAL, Job, Session

T = TypeVar("T")
#: Receives the job after each change.
OnChange = Callable[[Job], None]
#: Corrections in their order, see docs/corrections.md.
Corrections = Iterable[Mapping[str, Any]]
#: Longest time for which the service holds a request for a change of a job, s.
WAIT_S = 30
#: Statuses after which the same request can succeed: too many requests, busy.
BUSY = (429, 503)


@dataclass
class Request:
    """One request; a `repeatable` one has the same effect when it is sent twice."""

    method: str
    path: str
    body: Union[bytes, Body, None] = None
    headers: dict[str, str] = field(default_factory=dict)
    repeatable: bool = True


@dataclass
class Answer:
    """An answer; `error` is set where none arrived."""

    status: int
    headers: Mapping[str, str]
    body: bytes
    error: Optional[Exception] = None


@dataclass
class Pause:
    """Time to wait before the next request, s."""

    seconds: float


Operation = Generator[Union[Request, Pause], Answer, T]


def send(request: Request, patience_s: float) -> Operation[Answer]:
    """Sends a request; repeats it for `patience_s` while the service restarts or is busy, if a repetition is harmless."""
    deadline = time.monotonic() + patience_s
    wait_s = 0.2
    may_be_done = False
    while True:
        answer = yield request
        is_late = time.monotonic() > deadline
        if answer.error is not None:
            if is_late or not request.repeatable:
                raise answer.error
            may_be_done = True
        elif answer.status < 400 or (answer.status == 404 and request.method == "DELETE" and may_be_done):
            return answer  # what is gone was deleted by the request whose answer was lost
        elif answer.status not in BUSY or is_late:
            raise Problem.of(answer.status, answer.body)
        else:
            wait_s = _retry_after(answer.headers, wait_s)
        # Spread, so that clients that failed together do not return together.
        yield Pause(min(wait_s, max(0.0, deadline - time.monotonic())) * random.uniform(0.5, 1.0))
        wait_s = min(2 * wait_s, 5.0)


def _retry_after(headers: Mapping[str, str], otherwise: float) -> float:
    try:
        return float(headers.get("Retry-After", otherwise))
    except ValueError:
        return otherwise


def document(request: Request, patience_s: float) -> Operation[Any]:
    answer = yield from send(request, patience_s)
    return json.loads(answer.body)


def upload(body: Body, patience_s: float) -> Operation[Session]:
    # The service recognises bytes that it has, so that a repetition gives the same session.
    headers = {"Content-Type": body.media_type, "Content-Length": str(body.length)}
    try:
        session: Session = yield from document(Request("POST", "/v1/sessions", body, headers), patience_s)
        return session
    finally:
        body.close()


def submit(
    session: str,
    options: Optional[Mapping[str, Any]],
    labels: Optional[Mapping[str, str]],
    priority: int,
    webhook: Optional[str],
    key: Optional[str],
    patience_s: float,
) -> Operation[Job]:
    wanted: dict[str, Any] = {"session": session, "options": dict(options or {}), "labels": dict(labels or {}), "priority": priority}
    if webhook is not None:
        wanted["webhook"] = {"url": webhook}
    return (yield from created(wanted, key, patience_s))


def correct(job: str, corrections: Corrections, key: Optional[str], patience_s: float) -> Operation[Job]:
    wanted = {"corrects": job, "options": {"corrections": [dict(correction) for correction in corrections]}}
    return (yield from created(wanted, key, patience_s))


def created(wanted: Mapping[str, Any], key: Optional[str], patience_s: float) -> Operation[Job]:
    """Creates the job that a document describes."""
    headers = {"Idempotency-Key": key or str(uuid.uuid4()), "Content-Type": "application/json"}
    job: Job = yield from document(Request("POST", "/v1/jobs", json.dumps(wanted).encode(), headers), patience_s)
    return job


def wait(job: str, on_change: Optional[OnChange], patience_s: float) -> Operation[Job]:
    """Follows a job to its end by long polling."""
    etag: Optional[str] = None
    while True:
        headers = {"If-None-Match": etag} if etag else {}
        path = f"/v1/jobs/{job}" + (f"?wait={WAIT_S}" if etag else "")
        answer = yield from send(Request("GET", path, headers=headers), patience_s)
        etag = answer.headers.get("ETag", etag)
        if answer.status == 304:
            continue
        now: Job = json.loads(answer.body)
        if on_change:
            on_change(now)
        if now["state"] == "succeeded":
            return now
        if now["state"] in FINAL:
            raise JobFailed(now)


def artifact(job: str, name: str, patience_s: float) -> Operation[bytes]:
    answer = yield from send(Request("GET", f"/v1/jobs/{job}/artifacts/{quote(name)}"), patience_s)
    if hashlib.sha256(answer.body).hexdigest() != _digest_of(answer.headers.get("ETag", "")):
        raise DamagedDownload(f"{name}: the received bytes do not have the published digest; download it again")
    return answer.body


def _digest_of(etag: str) -> str:
    """The digest in an ETag, which a proxy that compresses answers makes weak."""
    return (etag[2:] if etag.startswith("W/") else etag).strip('"')


def download(job: str, folder: Union[str, os.PathLike[str]], patience_s: float) -> Operation[Result]:
    manifest = yield from document(Request("GET", f"/v1/jobs/{job}/result"), patience_s)
    for name in [file["name"] for file in manifest["files"]] + ["manifest.json"]:
        path = os.path.join(folder, *name.split("/"))
        if os.path.relpath(path, folder).startswith(".."):
            raise ValueError(f"{name}: the path of the file leaves the folder")
        content = yield from artifact(job, name, patience_s)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "wb") as file:
            file.write(content)
    return Result.open(folder)


def result(job: str, patience_s: float) -> Operation[Result]:
    documents = {}
    for name in Result.FILES:
        documents[name] = json.loads((yield from artifact(job, name, patience_s)))
    return Result(documents)


def page(path: str, query: Mapping[str, str], patience_s: float) -> Operation[Any]:
    full = path + ("?" + urlencode(query) if query else "")
    return (yield from document(Request("GET", full), patience_s))
