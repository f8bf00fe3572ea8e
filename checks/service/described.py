"""Catalogue D13: schemathesis compares the service with its OpenAPI document: all checks, links followed.

    python3 checks/service/described.py --schemathesis ENV/bin/schemathesis --cases 2000

Two runs: one on an empty service, and one on an existing session and a finished job, so that cases get past the lookup of
the id.
"""

import json
import os
import shutil
import subprocess
import tempfile

from harness import Faults, Service, arguments, take

HERE = os.path.dirname(os.path.abspath(__file__))
CONFIG, HOOKS = os.path.join(HERE, "schemathesis.toml"), os.path.join(HERE, "schemathesis_hooks.py")
OF_A_JOB = ["", "/archive", "/cameras", "/exports", "/people", "/report", "/result", "/deliveries", "/artifacts/{name}"]
OF_A_SESSION = ["", "/inspection"]


def main():
    options = arguments(__doc__, schemathesis="schemathesis", cases=2000, only_finished=0)
    faults = Faults()
    service = Service(options.program)
    service.start()
    client = service.client()
    with open(CONFIG) as file:
        config = f"hooks = {json.dumps(HOOKS)}\n" + file.read()
    if not options.only_finished:
        run_schemathesis(options, service, "on an empty service", config, [], faults)
    session = client.upload(take(30, 3, seed=1))["id"]
    job = client.submit(session, options={"extrinsics": "fixed"})["id"]
    client.wait(job)
    config += fixed("jobs", OF_A_JOB, job) + fixed("sessions", OF_A_SESSION, session)
    # What takes away is left to the run on an empty service.
    run_schemathesis(options, service, "on a finished job", config, ["--exclude-method", "DELETE"], faults)
    faults.require(client.job(job)["state"] == "succeeded", "D13: the finished job has changed")
    service.kill()
    faults.end(service, options.keep)


def fixed(kind, routes, name):
    """The part of the configuration that directs `routes` to one job or session."""
    names = ", ".join(f'"GET /v1/{kind}/{{id}}{route}"' for route in routes)
    return f'\n[[operations]]\ninclude-name = [{names}]\n[operations.parameters]\n"path.id" = "{name}"\n'


def run_schemathesis(options, service, name, config, words, faults):
    program = os.path.abspath(shutil.which(options.schemathesis) or options.schemathesis)
    with tempfile.TemporaryDirectory() as folder:  # schemathesis writes its cache into the current folder
        path = os.path.join(folder, "schemathesis.toml")
        with open(path, "w") as file:
            file.write(config)
        words = ["--config-file", path, "run", f"http://127.0.0.1:{service.port}/openapi.json", "--checks", "all",
                 "--max-examples", str(options.cases), "--seed", str(options.seed), *words]
        run = subprocess.run([program, *words], capture_output=True, text=True, cwd=folder)
    summary = [line.strip() for line in run.stdout.splitlines() if line.startswith("  ") and ("generated," in line or "Tested:" in line)]
    print(f"D13 {name}: {'; '.join(summary)}", flush=True)
    faults.require(run.returncode == 0, f"D13 {name}: {run.stdout[-3000:]}")


if __name__ == "__main__":
    main()
