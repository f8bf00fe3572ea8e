"""Errors that a caller can expect."""

from __future__ import annotations

import json
from typing import Any

from ._types import Job


class Problem(Exception):
    """An error answer (RFC 9457): `status`, `code`, `detail`, `remedy`, and `document`, the whole problem document."""

    def __init__(self, status: int, document: dict[str, Any]):
        self.status = status
        self.document = document
        self.code: str = document.get("code", "")
        self.detail: str = document.get("detail", "")
        self.remedy: str = document.get("remedy", "")
        super().__init__(f"{status} {self.code}: {self.detail}; {self.remedy}")

    @classmethod
    def of(cls, status: int, body: bytes) -> Problem:
        """The problem of an answer, whose body may come from a proxy and need not be a problem document."""
        try:
            document = json.loads(body)
        except ValueError:
            document = None
        if not isinstance(document, dict):
            document = {"detail": body[:200].decode("utf-8", "replace")}
        return cls(status, document)


class JobFailed(Exception):
    """A job that ended without a result; `job` is the job document."""

    def __init__(self, job: Job):
        self.job = job
        super().__init__(f"job {job['id']} {job['state']}: {job.get('error')}")


class DamagedDownload(Exception):
    """The received bytes of a file do not have the published digest; download the file again."""
