"""Catalogue D13: the service does what its own description says, by schemathesis: every check, links followed.

    python3 checks/service/described.py --schemathesis ENV/bin/schemathesis --cases 2000

Two runs: one from nothing, one that asks for a session and a finished job which are there, so that cases reach what lies
behind the look-up of an id.
"""

import os
import shutil
import subprocess
import tempfile

from harness import Faults, Service, arguments, take

CONFIG = os.path.join(os.path.dirname(os.path.abspath(__file__)), "schemathesis.toml")
OF_A_JOB = ["", "/cameras", "/people", "/report", "/result", "/deliveries", "/artifacts/{name}"]
OF_A_SESSION = ["", "/inspection"]


def main():
    asked = arguments(__doc__, schemathesis="schemathesis", cases=2000, only_finished=0)
    faults = Faults()
    service = Service(asked.program)
    service.start()
    client = service.client()
    with open(CONFIG) as file:
        config = file.read()
    if not asked.only_finished:
        followed(asked, service, "from nothing", config, [], faults)
    session = client.upload(take(30, 3, seed=1))["id"]
    job = client.submit(session, options={"extrinsics": "fixed"})["id"]
    client.wait(job)
    config += fixed("jobs", OF_A_JOB, job) + fixed("sessions", OF_A_SESSION, session)
    # What takes away is left to the run from nothing.
    followed(asked, service, "on a finished job", config, ["--exclude-method", "DELETE"], faults)
    faults.require(client.job(job)["state"] == "succeeded", "D13: the finished job has changed")
    service.kill()
    faults.end(service, asked.keep)


def fixed(kind, routes, name):
    """The part of a configuration that has `routes` below one job or session asked for."""
    names = ", ".join(f'"GET /v1/{kind}/{{id}}{route}"' for route in routes)
    return f'\n[[operations]]\ninclude-name = [{names}]\n[operations.parameters]\n"path.id" = "{name}"\n'


def followed(asked, service, name, config, words, faults):
    program = os.path.abspath(shutil.which(asked.schemathesis) or asked.schemathesis)
    with tempfile.TemporaryDirectory() as folder:  # schemathesis leaves its cache where it runs
        path = os.path.join(folder, "schemathesis.toml")
        with open(path, "w") as file:
            file.write(config)
        words = ["--config-file", path, "run", f"http://127.0.0.1:{service.port}/openapi.json", "--checks", "all",
                 "--max-examples", str(asked.cases), "--seed", str(asked.seed), *words]
        run = subprocess.run([program, *words], capture_output=True, text=True, cwd=folder)
    told = [line.strip() for line in run.stdout.splitlines() if line.startswith("  ") and ("generated," in line or "Tested:" in line)]
    print(f"D13 {name}: {'; '.join(told)}", flush=True)
    faults.require(run.returncode == 0, f"D13 {name}: {run.stdout[-3000:]}")


if __name__ == "__main__":
    main()
