"""Documents of the HTTP API, with the fields that a client uses; the API's description (`/docs`) has all of them."""

from __future__ import annotations

from typing import Any, Literal, Optional, TypedDict

State = Literal["queued", "running", "canceling", "succeeded", "failed", "canceled", "dead"]

#: States in which a job has ended; a final state never changes.
FINAL = ("succeeded", "failed", "canceled", "dead")


class Session(TypedDict, total=False):
    """An uploaded session."""

    id: str
    name: str
    sha256: str
    cameras: int
    frames: int
    people_max: int
    keypoint_convention: str
    format: str
    warnings: list[str]


class Progress(TypedDict):
    """Progress of a job; `fraction` is 0 to 1 and never falls, `eta_s` in seconds."""

    stage: str
    stage_index: int
    stage_count: int
    fraction: float
    message: str
    eta_s: Optional[float]


class Quality(TypedDict):
    """Verdict on a result: `pass`, `warn` or `reject`, with one sentence per reason."""

    verdict: str
    reasons: list[str]


class Job(TypedDict, total=False):
    """One reconstruction of one session."""

    id: str
    state: State
    session: str
    options: dict[str, Any]
    labels: dict[str, str]
    priority: int
    created_at: str
    started_at: Optional[str]
    finished_at: Optional[str]
    attempt: int
    progress: Progress
    stage_seconds: dict[str, float]
    quality: Optional[Quality]
    suspicions: list[dict[str, Any]]
    error: Optional[dict[str, Any]]
    solver_version: Optional[str]
