"""`python3 -m wandless SESSION RESULT_FOLDER`: uploads, follows the job, downloads the result."""

from __future__ import annotations

import argparse
import json
import os
import sys

import httpx

from ._client import Client
from ._errors import DamagedDownload, JobFailed, Problem


def main() -> int:
    """Exit codes are those of `wandless submit`: 1 failed, 2 unusable input, 3 verdict `reject`."""
    parser = argparse.ArgumentParser(prog="wandless-submit", description="Uploads, follows the job, downloads the result.")
    parser.add_argument("session", help="folder, zip or JSON document")
    parser.add_argument("result", help="folder of the result")
    parser.add_argument("--server", default="http://127.0.0.1:8700")
    parser.add_argument("--options", default="{}", help="options of the job as JSON; the key is read from WANDLESS_KEY")
    arguments = parser.parse_args()
    if not os.path.exists(arguments.session):
        parser.error(f"{arguments.session} does not exist")
    try:
        options = json.loads(arguments.options)
    except ValueError as error:
        parser.error(f"--options is not JSON: {error}")
    with Client(arguments.server) as client:
        try:
            job = client.solve(
                arguments.session,
                options,
                on_change=lambda job: print(job["state"], f"{job['progress']['fraction']:.0%}", job["progress"]["stage"]),
            )
            result = client.download(job["id"], arguments.result)
        except (JobFailed, DamagedDownload, httpx.TransportError, OSError) as failed:
            print(failed, file=sys.stderr)
            return 1
        except Problem as problem:
            print(problem, file=sys.stderr)
            return 2 if problem.status in (400, 413, 415, 422) else 1
    print(result.verdict, *result.report["quality"]["reasons"], sep="\n  - ")
    return 3 if result.verdict == "reject" else 0


if __name__ == "__main__":
    sys.exit(main())
