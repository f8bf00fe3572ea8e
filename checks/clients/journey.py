"""The whole way of a job with the client that openapi-python-client generates: python3 journey.py SERVER TAKE"""

import io
import json
import pathlib
import sys
import zipfile

from wandless_generated import Client, models
from wandless_generated.api.jobs import create_job, delete_job, get_job, list_jobs
from wandless_generated.api.results import add_exports, get_archive, get_artifact, get_report
from wandless_generated.api.sessions import create_session, delete_session, inspect_session
from wandless_generated.types import File

FINAL = ("succeeded", "failed", "canceled", "dead")


def require(answer, kind):
    """The answer, if it has the expected type; a problem document ends the program."""
    if not isinstance(answer, kind):
        raise SystemExit(f"expected {kind.__name__}, got {answer}")
    return answer


def zipped(folder):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(folder.rglob("*.json")):
            if "gt" not in path.relative_to(folder).parts:
                archive.write(path, path.relative_to(folder))
    return packed.getvalue()


server, take = sys.argv[1], pathlib.Path(sys.argv[2])
client = Client(base_url=server, timeout=60)

# The same session as a document and as a form with a zip.
document = json.loads((take / "session.json").read_text())
document["poses"] = {camera["id"]: json.loads((take / "poses" / f"{camera['id']}.json").read_text()) for camera in document["cameras"]}
session = require(create_session.sync(client=client, body=models.SessionDocument.from_dict(document)), models.Session)
form = models.CreateSessionFilesBody(session=File(payload=io.BytesIO(zipped(take)), file_name="take.zip"))
packed = require(create_session.sync(client=client, body=form), models.Session)
assert (session.cameras, session.frames) == (packed.cameras, packed.frames)
assert len(require(inspect_session.sync(session.id, client=client), models.Inspection).cameras) == session.cameras

options = models.Options(people=2, seed=22, fps=25.0, exports=[models.ExportFormat.SMPL_NPZ])
new = models.NewJob(session=session.id, options=options)
job = require(create_job.sync(client=client, body=new, idempotency_key="python"), models.Job)
assert require(create_job.sync(client=client, body=new, idempotency_key="python"), models.Job).id == job.id


def followed(job):
    while job.state.value not in FINAL:
        job = require(get_job.sync(job.id, client=client, wait=30), models.Job)
    assert job.state.value == "succeeded" and job.progress.fraction == 1.0, job.error
    return job


job = followed(job)
assert job.id in [each.id for each in require(list_jobs.sync(client=client), models.JobPage).jobs]

report = get_report.sync(job.id, client=client).to_dict()
assert report["quality"]["verdict"] in ("pass", "warn"), report["quality"]
manifest = add_exports.sync(job.id, client=client, body=models.NewExports(exports=[models.ExportFormat.GLB])).to_dict()
assert "scene.glb" in [file["name"] for file in manifest["files"]]
scene = require(get_artifact.sync(job.id, "scene.glb", client=client), File).payload.read()
with zipfile.ZipFile(require(get_archive.sync(job.id, client=client), File).payload) as archive:
    assert archive.read("scene.glb") == scene

def corrected(*edits):
    """The corrected job and the names of its people by their numbers."""
    wanted = models.Options.from_dict({**options.to_dict(), "corrections": list(edits)})
    done = followed(require(create_job.sync(client=client, body=models.NewJob(corrects=job.id, options=wanted)), models.Job))
    assert "cameras" not in done.stage_seconds.to_dict(), "it did not continue from the first job"
    return done, {person["id"]: person.get("name") for person in get_report.sync(done.id, client=client).to_dict()["people"]}


named = {"action": "rename", "person": 0, "name": "Ada"}
both, people = corrected(named, {"action": "exclude_person", "person": 1})
assert people == {0: "Ada"}, people
undone, people = corrected(named)
assert people == {0: "Ada", 1: None}, people
for done in (both, undone):
    assert require(get_artifact.sync(done.id, "people.json", client=client), File).payload.read()
    assert delete_job.sync_detailed(done.id, client=client).status_code == 204

refusal = require(create_job.sync(client=client, body=models.NewJob(session="session_" + "0" * 32)), models.Problem)
assert (refusal.status, refusal.code) == (404, "session_not_found") and refusal.remedy
assert delete_job.sync_detailed(job.id, client=client).status_code == 204
assert delete_session.sync_detailed(session.id, client=client).status_code == 204
