"""Client of the wandless service, with and without asyncio.

    from wandless import Client

    with Client("http://127.0.0.1:8700") as client:
        job = client.solve("take", options={"people": 3, "fps": 25})
        result = client.result(job["id"])
    arrays = result.to_numpy()

`AsyncClient` has the same methods as coroutines.
"""

from ._async_client import AsyncClient
from ._client import Client
from ._errors import DamagedDownload, JobFailed, Problem
from ._result import Result
from ._sources import session_document
from ._types import Job, Progress, Quality, Session
from ._webhooks import check_webhook

__all__ = [
    "AsyncClient", "Client", "DamagedDownload", "Job", "JobFailed", "Problem", "Progress", "Quality", "Result", "Session",
    "check_webhook", "session_document",
]
__version__ = "0.1.0"
