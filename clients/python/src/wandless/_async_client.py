"""The client for asyncio: the methods of `Client` as coroutines."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Mapping
from typing import Any, Optional, TypeVar, Union

import httpx

from . import _operations as operations
from ._client import EventLines, key_headers, unanswered
from ._errors import Problem
from ._operations import Answer, OnChange, Operation, Request
from ._result import Result
from ._sources import Body, OnUpload, Source, body_of
from ._types import Job, Session

T = TypeVar("T")


class AsyncClient:
    """Client of one service for asyncio; arguments and errors are those of `Client`."""

    def __init__(
        self,
        server: str = "http://127.0.0.1:8700",
        key: Optional[str] = None,
        timeout_s: float = 330.0,
        patience_s: float = 60.0,
    ):
        self.patience_s = patience_s
        self._http = httpx.AsyncClient(base_url=server.rstrip("/"), headers=key_headers(key), timeout=timeout_s)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes the connections."""
        await self._http.aclose()

    async def solve(
        self,
        source: Source,
        options: Optional[Mapping[str, Any]] = None,
        on_upload: Optional[OnUpload] = None,
        on_change: Optional[OnChange] = None,
    ) -> Job:
        """Uploads a session, submits a job and follows it to its end; raises `JobFailed` if it has no result."""
        session = await self.upload(source, on_upload)
        return await self.wait((await self.submit(session["id"], options))["id"], on_change)

    async def upload(self, source: Source, on_upload: Optional[OnUpload] = None) -> Session:
        """Uploads a session, see `Client.upload`."""
        body = await asyncio.to_thread(body_of, source, on_upload)
        return await self._run(operations.upload(body, self.patience_s))

    async def inspect(self, session: str) -> dict[str, Any]:
        """Inspects a session before it is solved."""
        found: dict[str, Any] = await self._json("GET", f"/v1/sessions/{session}/inspection")
        return found

    def sessions(self) -> AsyncIterator[Session]:
        """All sessions, newest first."""
        return self._pages("/v1/sessions", "sessions", {})

    async def delete_session(self, session: str) -> None:
        """Deletes a session that no job uses."""
        await self._run(operations.send(Request("DELETE", f"/v1/sessions/{session}"), self.patience_s))

    async def submit(
        self,
        session: str,
        options: Optional[Mapping[str, Any]] = None,
        labels: Optional[Mapping[str, str]] = None,
        priority: int = 0,
        webhook: Optional[str] = None,
        key: Optional[str] = None,
    ) -> Job:
        """Submits a job, see `Client.submit`."""
        return await self._run(operations.submit(session, options, labels, priority, webhook, key, self.patience_s))

    async def correct(self, job: str, corrections: operations.Corrections, key: Optional[str] = None) -> Job:
        """Submits a job that corrects a succeeded one, see `Client.correct`."""
        return await self._run(operations.correct(job, corrections, key, self.patience_s))

    async def job(self, job: str) -> Job:
        """The job as it is now."""
        found: Job = await self._json("GET", f"/v1/jobs/{job}")
        return found

    def jobs(self, state: Optional[str] = None, label: Optional[str] = None) -> AsyncIterator[Job]:
        """Jobs, newest first."""
        return self._pages("/v1/jobs", "jobs", {key: value for key, value in (("state", state), ("label", label)) if value})

    async def wait(self, job: str, on_change: Optional[OnChange] = None) -> Job:
        """Follows a job to its end and returns it; raises `JobFailed` if it has no result."""
        return await self._run(operations.wait(job, on_change, self.patience_s))

    async def events(self, job: str) -> AsyncIterator[tuple[str, Any]]:
        """The events of a job, pairs of name (`state`, `progress`, `scene`, `log`) and data, until it ends."""
        async with self._http.stream("GET", f"/v1/jobs/{job}/events") as answer:
            if answer.status_code != 200:
                raise Problem.of(answer.status_code, await answer.aread())
            lines = EventLines()
            async for line in answer.aiter_lines():
                if (event := lines.add(line)) is not None:
                    yield event

    async def cancel(self, job: str) -> Job:
        """Cancels a job; the work stops within 2 s."""
        found: Job = await self._json("POST", f"/v1/jobs/{job}/cancel")
        return found

    async def delete_job(self, job: str) -> None:
        """Deletes a job with its result."""
        await self._run(operations.send(Request("DELETE", f"/v1/jobs/{job}"), self.patience_s))

    async def export(self, job: str, formats: list[str]) -> dict[str, Any]:
        """Adds export formats to the result of a finished job; returns its new manifest."""
        body = json.dumps({"exports": formats}).encode()
        request = Request("POST", f"/v1/jobs/{job}/exports", body, {"Content-Type": "application/json"})
        found: dict[str, Any] = await self._run(operations.document(request, self.patience_s))
        return found

    async def manifest(self, job: str) -> dict[str, Any]:
        """The list of all files of a result."""
        found: dict[str, Any] = await self._json("GET", f"/v1/jobs/{job}/result")
        return found

    async def artifact(self, job: str, name: str) -> bytes:
        """One file of a result, after a check of its digest."""
        return await self._run(operations.artifact(job, name, self.patience_s))

    async def download(self, job: str, folder: Union[str, os.PathLike[str]]) -> Result:
        """Writes all files of a result into `folder` and opens it."""
        return await self._run(operations.download(job, folder, self.patience_s))

    async def archive(self, job: str, path: Union[str, os.PathLike[str]]) -> None:
        """Writes all files of a result as one zip."""
        async with self._http.stream("GET", f"/v1/jobs/{job}/archive") as answer:
            if answer.status_code != 200:
                raise Problem.of(answer.status_code, await answer.aread())
            with open(path, "wb") as file:
                async for chunk in answer.aiter_bytes():
                    file.write(chunk)

    async def webhook_secret(self) -> str:
        """The secret that signs webhooks, for `check_webhook`."""
        secret: str = (await self._json("GET", "/v1/webhook-secret"))["secret"]
        return secret

    async def rotate_webhook_secret(self) -> str:
        """Replaces the secret; calls are signed with both for 24 hours."""
        request = Request("POST", "/v1/webhook-secret", repeatable=False)
        secret: str = (await self._run(operations.document(request, self.patience_s)))["secret"]
        return secret

    async def deliveries(self, job: str) -> list[dict[str, Any]]:
        """The webhook calls of a job."""
        listed: list[dict[str, Any]] = (await self._json("GET", f"/v1/jobs/{job}/deliveries"))["deliveries"]
        return listed

    async def redeliver(self, job: str, delivery: str) -> None:
        """Repeats a webhook call."""
        request = Request("POST", f"/v1/jobs/{job}/deliveries/{delivery}/redeliver")
        await self._run(operations.send(request, self.patience_s))

    async def result(self, job: str) -> Result:
        """The documents of a result in memory."""
        return await self._run(operations.result(job, self.patience_s))

    async def _json(self, method: str, path: str) -> Any:
        return await self._run(operations.document(Request(method, path), self.patience_s))

    async def _pages(self, path: str, items: str, query: dict[str, str]) -> AsyncIterator[Any]:
        while True:
            page = await self._run(operations.page(path, query, self.patience_s))
            for item in page[items]:
                yield item
            if page["next_page_token"] is None:
                return
            query = {**query, "page_token": page["next_page_token"]}

    async def _run(self, operation: Operation[T]) -> T:
        step: Any = None
        try:
            while True:
                wanted = operation.send(step)
                step = None
                if isinstance(wanted, Request):
                    step = await self._answer(wanted)
                else:
                    await asyncio.sleep(wanted.seconds)
        except StopIteration as end:
            done: T = end.value
            return done

    async def _answer(self, request: Request) -> Answer:
        content = _chunks(request.body) if isinstance(request.body, Body) else request.body
        try:
            answer = await self._http.request(request.method, request.path, content=content, headers=request.headers)
        except httpx.TransportError as error:
            return unanswered(error)
        return Answer(answer.status_code, answer.headers, answer.content)


async def _chunks(body: Body) -> AsyncIterator[bytes]:
    for chunk in body.chunks():
        yield chunk
