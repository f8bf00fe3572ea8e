"""The blocking client."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from typing import Any, Optional, TypeVar, Union

import httpx

from . import _operations as operations
from ._errors import Problem
from ._operations import Answer, OnChange, Operation, Request
from ._result import Result
from ._sources import Body, OnUpload, Source, body_of
from ._types import Job, Session

T = TypeVar("T")
#: Errors of a request that was never sent, such as one to an address without http://: a repetition fails in the same way.
UNSENDABLE = (httpx.UnsupportedProtocol, httpx.LocalProtocolError)


class Client:
    """Client of one service; it can be used from several threads.

    `key`: API key, by default that of the environment variable `WANDLESS_KEY`. `timeout_s`: longest silence of the service.
    `patience_s`: how long requests are repeated while the service restarts or is busy.
    """

    def __init__(
        self,
        server: str = "http://127.0.0.1:8700",
        key: Optional[str] = None,
        timeout_s: float = 330.0,
        patience_s: float = 60.0,
    ):
        self.patience_s = patience_s
        self._http = httpx.Client(base_url=server.rstrip("/"), headers=key_headers(key), timeout=timeout_s)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def solve(
        self,
        source: Source,
        options: Optional[Mapping[str, Any]] = None,
        on_upload: Optional[OnUpload] = None,
        on_change: Optional[OnChange] = None,
    ) -> Job:
        """Uploads a session, submits a job and follows it to its end; raises `JobFailed` if it has no result."""
        session = self.upload(source, on_upload)
        return self.wait(self.submit(session["id"], options)["id"], on_change)

    def upload(self, source: Source, on_upload: Optional[OnUpload] = None) -> Session:
        """Uploads a session: a folder, a file, its bytes, a session document (`session_document`) or files by their names.

        `on_upload` receives the sent share, 0 to 1.
        """
        return self._run(operations.upload(body_of(source, on_upload), self.patience_s))

    def inspect(self, session: str) -> dict[str, Any]:
        """Inspects a session before it is solved: cameras that see the same people, findings, expected error and time."""
        found: dict[str, Any] = self._json("GET", f"/v1/sessions/{session}/inspection")
        return found

    def sessions(self) -> Iterator[Session]:
        """All sessions, newest first."""
        return self._pages("/v1/sessions", "sessions", {})

    def delete_session(self, session: str) -> None:
        """Deletes a session that no job uses."""
        self._run(operations.send(Request("DELETE", f"/v1/sessions/{session}"), self.patience_s))

    def submit(
        self,
        session: str,
        options: Optional[Mapping[str, Any]] = None,
        labels: Optional[Mapping[str, str]] = None,
        priority: int = 0,
        webhook: Optional[str] = None,
        key: Optional[str] = None,
    ) -> Job:
        """Submits a job. A repetition with the same idempotency `key` returns the same job; without it a new one is used."""
        return self._run(operations.submit(session, options, labels, priority, webhook, key, self.patience_s))

    def correct(self, job: str, corrections: operations.Corrections, key: Optional[str] = None) -> Job:
        """Submits a job that corrects the people of a succeeded job, such as `[{"action": "merge", "people": [1, 3]}]`.

        The list replaces the corrections of that job. The new job continues from what they leave valid.
        """
        return self._run(operations.correct(job, corrections, key, self.patience_s))

    def job(self, job: str) -> Job:
        """The job as it is now."""
        found: Job = self._json("GET", f"/v1/jobs/{job}")
        return found

    def jobs(self, state: Optional[str] = None, label: Optional[str] = None) -> Iterator[Job]:
        """Jobs, newest first."""
        return self._pages("/v1/jobs", "jobs", {key: value for key, value in (("state", state), ("label", label)) if value})

    def wait(self, job: str, on_change: Optional[OnChange] = None) -> Job:
        """Follows a job to its end and returns it; raises `JobFailed` if it has no result."""
        return self._run(operations.wait(job, on_change, self.patience_s))

    def events(self, job: str) -> Iterator[tuple[str, Any]]:
        """The events of a job, pairs of name (`state`, `progress`, `scene`, `log`) and data, until it ends."""
        with self._http.stream("GET", f"/v1/jobs/{job}/events") as answer:
            if answer.status_code != 200:
                raise Problem.of(answer.status_code, answer.read())
            lines = EventLines()
            for line in answer.iter_lines():
                if (event := lines.add(line)) is not None:
                    yield event

    def cancel(self, job: str) -> Job:
        """Cancels a job; the work stops within 2 s."""
        found: Job = self._json("POST", f"/v1/jobs/{job}/cancel")
        return found

    def delete_job(self, job: str) -> None:
        """Deletes a job with its result."""
        self._run(operations.send(Request("DELETE", f"/v1/jobs/{job}"), self.patience_s))

    def export(self, job: str, formats: list[str]) -> dict[str, Any]:
        """Adds export formats to the result of a finished job; returns its new manifest."""
        body = json.dumps({"exports": formats}).encode()
        request = Request("POST", f"/v1/jobs/{job}/exports", body, {"Content-Type": "application/json"})
        found: dict[str, Any] = self._run(operations.document(request, self.patience_s))
        return found

    def manifest(self, job: str) -> dict[str, Any]:
        """The list of all files of a result."""
        found: dict[str, Any] = self._json("GET", f"/v1/jobs/{job}/result")
        return found

    def artifact(self, job: str, name: str) -> bytes:
        """One file of a result, after a check of its digest."""
        return self._run(operations.artifact(job, name, self.patience_s))

    def download(self, job: str, folder: Union[str, os.PathLike[str]]) -> Result:
        """Writes all files of a result into `folder` and opens it."""
        return self._run(operations.download(job, folder, self.patience_s))

    def archive(self, job: str, path: Union[str, os.PathLike[str]]) -> None:
        """Writes all files of a result as one zip."""
        with self._http.stream("GET", f"/v1/jobs/{job}/archive") as answer:
            if answer.status_code != 200:
                raise Problem.of(answer.status_code, answer.read())
            with open(path, "wb") as file:
                for chunk in answer.iter_bytes():
                    file.write(chunk)

    def webhook_secret(self) -> str:
        """The secret that signs webhooks, for `check_webhook`."""
        secret: str = self._json("GET", "/v1/webhook-secret")["secret"]
        return secret

    def rotate_webhook_secret(self) -> str:
        """Replaces the secret; calls are signed with both for 24 hours."""
        request = Request("POST", "/v1/webhook-secret", repeatable=False)
        secret: str = self._run(operations.document(request, self.patience_s))["secret"]
        return secret

    def deliveries(self, job: str) -> list[dict[str, Any]]:
        """The webhook calls of a job."""
        listed: list[dict[str, Any]] = self._json("GET", f"/v1/jobs/{job}/deliveries")["deliveries"]
        return listed

    def redeliver(self, job: str, delivery: str) -> None:
        """Repeats a webhook call."""
        request = Request("POST", f"/v1/jobs/{job}/deliveries/{delivery}/redeliver")
        self._run(operations.send(request, self.patience_s))

    def result(self, job: str) -> Result:
        """The documents of a result in memory."""
        return self._run(operations.result(job, self.patience_s))

    def _json(self, method: str, path: str) -> Any:
        return self._run(operations.document(Request(method, path), self.patience_s))

    def _pages(self, path: str, items: str, query: dict[str, str]) -> Iterator[Any]:
        while True:
            page = self._run(operations.page(path, query, self.patience_s))
            yield from page[items]
            if page["next_page_token"] is None:
                return
            query = {**query, "page_token": page["next_page_token"]}

    def _run(self, operation: Operation[T]) -> T:
        step: Any = None
        try:
            while True:
                wanted = operation.send(step)
                step = None
                if isinstance(wanted, Request):
                    step = self._answer(wanted)
                else:
                    time.sleep(wanted.seconds)
        except StopIteration as end:
            done: T = end.value
            return done

    def _answer(self, request: Request) -> Answer:
        content = request.body.chunks() if isinstance(request.body, Body) else request.body
        try:
            answer = self._http.request(request.method, request.path, content=content, headers=request.headers)
        except httpx.TransportError as error:
            return unanswered(error)
        return Answer(answer.status_code, answer.headers, answer.content)


def unanswered(error: httpx.TransportError) -> Answer:
    """What a request without an answer gives, so that it can be repeated; raises the error of one that was never sent."""
    if isinstance(error, UNSENDABLE):
        raise error
    return Answer(0, {}, b"", error)


def key_headers(key: Optional[str]) -> dict[str, str]:
    """The header that sends an API key; without a key that of the environment."""
    key = key or os.environ.get("WANDLESS_KEY")
    return {"Authorization": f"Bearer {key.strip()}"} if key and key.strip() else {}


class EventLines:
    """Collects the lines of server-sent events."""

    def __init__(self) -> None:
        self.name = "message"
        self.data: list[str] = []

    def add(self, line: str) -> Optional[tuple[str, Any]]:
        """The event that ends with this line."""
        if line.startswith("event:"):
            self.name = line[6:].strip()
        elif line.startswith("data:"):
            self.data.append(line[5:].strip())
        elif not line and self.data:
            event = (self.name, json.loads("\n".join(self.data)))
            self.name, self.data = "message", []
            return event
        return None
