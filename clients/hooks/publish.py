"""A webhook receiver that publishes results to Kitsu or ShotGrid.

    WANDLESS_WEBHOOK_SECRET=whsec_… WANDLESS_KEY=… python publish.py --to kitsu --folder /publish --port 8800

A job is published where its labels name a task: `kitsu_task` (id of the task), or `shotgrid_project`, `shotgrid_entity`
(such as `Shot:1234`) and optionally `shotgrid_task` (their ids). Jobs without these labels are ignored. Kitsu reads `KITSU_HOST`,
`KITSU_TOKEN` and `KITSU_STATUS` (short name of the status that a published task gets, default `wfa`); ShotGrid reads
`SHOTGRID_SITE`, `SHOTGRID_SCRIPT` and `SHOTGRID_KEY`.
"""

import argparse
import json
import os
import queue
import shutil
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import wandless

MAX_BODY_BYTES = 1 << 20
#: The files of a result that are attached to Kitsu's comment, where the result has them.
ATTACHED = ("scene.glb", "report.json")


def summary(report):
    """Verdict and figures of a result in a few lines."""
    quality = report["quality"]
    lines = [f"wandless: {quality['verdict']}", *quality["reasons"]]
    lines.append(f"{len(report['people'])} people, {sum(camera['solved'] for camera in report['cameras'])} of {len(report['cameras'])} cameras")
    return "\n".join(lines)


def publish_to_kitsu(job, folder, report):
    """Comments the task of the label `kitsu_task`, which changes its status, and attaches the scene."""
    import gazu

    gazu.client.set_host(os.environ["KITSU_HOST"])
    gazu.client.set_tokens({"access_token": os.environ["KITSU_TOKEN"]})
    wanted = os.environ.get("KITSU_STATUS", "wfa") if report["quality"]["verdict"] != "reject" else "retake"
    status = gazu.task.get_task_status_by_short_name(wanted)
    if status is None:
        raise RuntimeError(f"Kitsu has no task status with the short name {wanted!r}; set KITSU_STATUS")
    files = [str(folder / name) for name in ATTACHED if (folder / name).is_file()]
    gazu.task.add_comment(job["labels"]["kitsu_task"], status, summary(report), attachments=files)


def publish_to_shotgrid(job, folder, report):
    """Creates a PublishedFile of the entity of the label `shotgrid_entity`, unless one of this job exists."""
    import shotgun_api3

    site = shotgun_api3.Shotgun(os.environ["SHOTGRID_SITE"], os.environ["SHOTGRID_SCRIPT"], os.environ["SHOTGRID_KEY"])
    labels, code = job["labels"], f"wandless {job['id']}"
    project = {"type": "Project", "id": int(labels["shotgrid_project"])}
    kind, _, number = labels["shotgrid_entity"].partition(":")
    if site.find_one("PublishedFile", [["project", "is", project], ["code", "is", code]]):
        return
    published = {
        "project": project,
        "code": code,
        "name": job["id"],
        "entity": {"type": kind, "id": int(number)},
        "path": {"url": folder.as_uri(), "name": folder.name},
        "description": summary(report),
    }
    if "shotgrid_task" in labels:
        published["task"] = {"type": "Task", "id": int(labels["shotgrid_task"])}
    made = site.create("PublishedFile", published)
    site.upload("PublishedFile", made["id"], str(folder / "report.json"), display_name="report.json")


TARGETS = {
    "kitsu": (("kitsu_task",), publish_to_kitsu),
    "shotgrid": (("shotgrid_project", "shotgrid_entity"), publish_to_shotgrid),
}


class Publisher:
    """Publishes succeeded jobs one after the other, each delivery once."""

    def __init__(self, client, target, folder):
        self.client, self.folder = client, Path(folder)
        self.labels, self.publish = TARGETS[target]
        self.waiting, self.known, self.lock = queue.Queue(), set(), threading.Lock()
        self.folder.mkdir(parents=True, exist_ok=True)

    def take(self, delivery, event):
        """Accepts an event; a repeated delivery of one that is known is not published again."""
        with self.lock:
            if delivery in self.known:
                return
            self.known.add(delivery)
        if event["type"] == "job.succeeded":
            self.waiting.put((delivery, event["data"]["id"]))

    def run(self):
        """Publishes until the program ends."""
        while True:
            delivery, job = self.waiting.get()
            try:
                self.publish_job(job)
            except Exception as error:  # one job must not end the receiver; the service can repeat the delivery
                with self.lock:
                    self.known.discard(delivery)
                print(f"{job}: not published: {error}", file=sys.stderr, flush=True)
            self.waiting.task_done()

    def publish_job(self, name):
        job = self.client.job(name)
        if not all(label in job["labels"] for label in self.labels):
            print(f"{name}: ignored, it has no label {' and '.join(self.labels)}", flush=True)
            return
        self.client.export(name, ["glb"])
        folder = self.folder / name
        if not folder.exists():
            self.download(name, folder)
        self.publish(job, folder, json.loads((folder / "report.json").read_text()))
        print(f"{name}: published", flush=True)

    def download(self, name, folder):
        """Gives the folder its name when it is complete: what a failed download leaves must not be published."""
        part = folder.with_name(name + ".part")
        shutil.rmtree(part, ignore_errors=True)
        self.client.download(name, part)
        part.rename(folder)


def handler_of(publisher, secret):
    class Handler(BaseHTTPRequestHandler):
        """Checks the signature and answers at once; the work is done by the publisher."""

        def do_POST(self):
            length = self.headers.get("Content-Length") or ""
            body = self.rfile.read(int(length)) if length.isdecimal() and int(length) <= MAX_BODY_BYTES else b""
            if not wandless.check_webhook(secret, dict(self.headers.items()), body):
                return self.answer(401)
            publisher.take(self.headers["webhook-id"], json.loads(body))
            self.answer(204)

        def answer(self, status):
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_):
            pass

    return Handler


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--to", choices=TARGETS, required=True)
    parser.add_argument("--server", default="http://127.0.0.1:8700", help="URL of the service")
    parser.add_argument("--folder", required=True, help="folder that gets a folder for each result")
    parser.add_argument("--port", type=int, default=8800)
    arguments = parser.parse_args()
    publisher = Publisher(wandless.Client(arguments.server), arguments.to, arguments.folder)
    threading.Thread(target=publisher.run, daemon=True).start()
    handler = handler_of(publisher, os.environ["WANDLESS_WEBHOOK_SECRET"])
    server = ThreadingHTTPServer(("127.0.0.1", arguments.port), handler)
    print(f"http://127.0.0.1:{server.server_port}", flush=True)
    server.serve_forever()


if __name__ == "__main__":
    main()
