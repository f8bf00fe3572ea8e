"""Solves a session folder and prints cameras and people: python3 solve_folder.py FOLDER [SERVER]"""

import sys

from wandless import Client, JobFailed

folder, *server = sys.argv[1:]
with Client(*server) as client:
    try:
        job = client.solve(
            folder,
            options={"exports": ["glb"]},
            on_upload=lambda share: print(f"uploaded {share:.0%}"),
            on_change=lambda job: print(f"{job['state']} {job['progress']['fraction']:.0%} {job['progress']['message']}"),
        )
    except JobFailed as failed:
        sys.exit(str(failed))
    result = client.result(job["id"])

print("verdict", result.verdict, *result.report["quality"]["reasons"], sep="\n  ")
print(result.to_pandas("cameras").to_string(index=False))
print(result.to_pandas("people").to_string(index=False))
