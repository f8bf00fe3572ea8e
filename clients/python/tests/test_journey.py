"""The whole way of a take through a real service, with both clients."""

import asyncio
import datetime
import http.server
import json
import subprocess
import sys
import threading
import time
import zipfile

import numpy as np
import pytest
from conftest import ROOT

from wandless import AsyncClient, Client, JobFailed, Problem, Result, check_webhook, session_document

N_FRAMES, N_CAMERAS = 40, 3


@pytest.fixture()
def client(server):
    with Client(server) as client:
        yield client


def test_folder_is_solved_followed_and_downloaded(client, take, tmp_path):
    shares, fractions = [], []
    session = client.upload(take, shares.append)
    assert shares[-1] == 1.0 and shares == sorted(shares)
    assert client.upload(str(take))["id"] == session["id"], "the same folder has the same bytes"
    assert len(client.inspect(session["id"])["cameras"]) == N_CAMERAS
    first = client.submit(session["id"], {"seed": 1}, labels={"take": "7"}, key="once")
    assert client.submit(session["id"], {"seed": 1}, labels={"take": "7"}, key="once")["id"] == first["id"]
    job = client.wait(first["id"], lambda job: fractions.append(job["progress"]["fraction"]))
    assert fractions == sorted(fractions) and job["quality"]["verdict"] in ("pass", "warn")
    assert [found["id"] for found in client.jobs(label="take=7")] == [job["id"]]
    events = list(client.events(job["id"]))
    assert events[-1][0] == "state" and events[-1][1]["state"] == "succeeded"

    result = client.download(job["id"], tmp_path / "result")
    assert result.verdict == client.result(job["id"]).verdict == Result.open(tmp_path / "result").verdict
    client.delete_job(job["id"])
    with pytest.raises(Problem) as refusal:
        client.job(job["id"])
    assert refusal.value.status == 404


def test_result_as_arrays_and_tables(client, take):
    result = client.result(client.solve(take)["id"])
    arrays = result.to_numpy()
    n = len(result.people)
    assert n == 2 and arrays["joints"].shape == (n, len(arrays["frames"]), 24, 3)
    assert arrays["poses"].shape == (n, len(arrays["frames"]), 72) and arrays["betas"].shape == (n, 10)
    pelvis = arrays["joints"][0, arrays["valid"][0], 0]
    assert np.isfinite(pelvis).all() and np.abs(pelvis).max() < 50
    assert np.allclose(arrays["R"] @ arrays["R"].transpose(0, 2, 1), np.eye(3), atol=1e-9)
    centres = -np.einsum("cji,cj->ci", arrays["R"], arrays["t"])
    assert np.allclose(centres, arrays["positions"], atol=1e-5)
    table = result.to_pandas()
    row = table[(table.frame == arrays["frames"][0]) & (table.person == 0) & (table.joint == arrays["joint_names"][5])]
    assert np.allclose(row[["x", "y", "z"]].to_numpy()[0], arrays["joints"][0, 0, 5])
    assert list(result.to_pandas("cameras").id) == list(arrays["camera_ids"])
    assert len(result.to_pandas("people")) == n
    with pytest.raises(ValueError):
        result.to_pandas("nothing")


def test_result_as_neurodata_without_borders(client, take, tmp_path):
    ndx_pose = pytest.importorskip("ndx_pose")
    pynwb = pytest.importorskip("pynwb")
    result = client.result(client.solve(take)["id"])
    start = datetime.datetime(2024, 5, 1, 9, 30, tzinfo=datetime.timezone.utc)
    result.to_nwb(tmp_path / "take.nwb", start, identifier="take 7")
    arrays = result.to_numpy()
    with pynwb.NWBHDF5IO(tmp_path / "take.nwb", "r") as opened:
        file = opened.read()
        assert file.identifier == "take 7" and file.session_start_time == start
        found = file.processing["behavior"]
        skeleton = found["Skeletons"]["smpl"]
        assert list(skeleton.nodes[:]) == list(arrays["joint_names"]) and len(skeleton.edges) == 23
        for row, person in enumerate(result.people):
            estimate = found[f"person_{person['id']}"]
            assert isinstance(estimate, ndx_pose.PoseEstimation) and estimate.skeleton.name == "smpl"
            series = estimate["left_knee"]
            begin = person["frames"][0] - arrays["frames"][0]
            expected = arrays["joints"][row, begin : begin + len(person["frames"]), 4]
            assert np.array_equal(series.data[:], expected) and series.rate == result.fps
            assert list(series.confidence[:]) == [float(valid) for valid in person["valid"]]
    with pytest.raises(ValueError):
        result.to_nwb(tmp_path / "naive.nwb", start.replace(tzinfo=None))


def test_sessions_in_memory(client, take):
    files = {str(path.relative_to(take)): path.read_bytes() for path in take.rglob("*.json") if "gt" not in path.parts}
    assert client.upload(files)["cameras"] == N_CAMERAS
    header = json.loads(files["session.json"])
    keypoints = {}
    for camera in header["cameras"]:
        frames = json.loads(files[f"poses/{camera['id']}.json"])["frames"]
        keypoints[camera["id"]] = [np.array([person["keypoints"] for person in frame["people"]]) for frame in frames]
    document = session_document(header["cameras"], keypoints, 25, header["keypoint_convention"], "in memory")
    uploaded = client.upload(document)
    assert (uploaded["frames"], uploaded["name"], uploaded["people_max"]) == (N_FRAMES, "in memory", 2)
    assert client.upload(json.dumps(document).encode())["id"] == uploaded["id"]


def test_formats_are_added_after_the_solve(client, take, tmp_path):
    job = client.solve(take, {"seed": 2})["id"]
    before = {file["name"]: file["sha256"] for file in client.manifest(job)["files"]}
    assert not any(name.endswith(".bvh") for name in before)
    manifest = client.export(job, ["bvh", "glb"])
    after = {file["name"]: file["sha256"] for file in manifest["files"]}
    assert before.items() <= after.items() and any(name.endswith(".bvh") for name in after)
    assert client.export(job, ["glb"]) == manifest == client.manifest(job)
    client.archive(job, tmp_path / "result.zip")
    with zipfile.ZipFile(tmp_path / "result.zip") as archive:
        assert set(archive.namelist()) == set(after) | {"manifest.json"} and archive.testzip() is None
        assert archive.read("scene.glb") == client.artifact(job, "scene.glb")
    with pytest.raises(Problem) as refusal:
        client.export(job, ["mp3"])
    assert refusal.value.status == 400 and "smpl_npz" in refusal.value.detail


def test_people_are_corrected_after_the_solve(client, take):
    job = client.solve(take)
    first, second = client.result(job["id"]).people[:2]
    corrections = [{"action": "rename", "person": first["id"], "name": "Ada"}, {"action": "exclude_person", "person": second["id"]}]
    corrected = client.wait(client.correct(job["id"], corrections)["id"])
    assert corrected["session"] == job["session"] and "cameras" not in corrected["stage_seconds"], "it did not continue"
    people = client.result(corrected["id"]).people
    assert [person.get("name") for person in people] == ["Ada"]
    undone = client.wait(client.correct(corrected["id"], corrections[:1])["id"])
    assert len(client.result(undone["id"]).people) == 2
    with pytest.raises(JobFailed) as failure:
        client.wait(client.correct(job["id"], [{"action": "exclude_person", "person": 9}])["id"])
    assert "person 9 does not exist" in str(failure.value)
    with pytest.raises(Problem) as refusal:
        client.correct(job["id"], [{"action": "exclude_camera", "camera": "nowhere"}])
    assert "nowhere" in str(refusal.value)


def test_errors_name_what_to_do(client, take, tmp_path):
    video = tmp_path / "take.mp4"
    video.write_bytes(b"\0\0\0\x20ftypisom" + bytes(100))
    with pytest.raises(Problem) as refusal:
        client.upload({"cam1.mp4": video.read_bytes()})
    assert refusal.value.code == "poses_not_detected" and "--write_json" in refusal.value.remedy
    session = client.upload(take)["id"]
    with pytest.raises(Problem) as refusal:
        client.submit(session, {"poeple": 2})
    assert (refusal.value.status, refusal.value.code) == (400, "option_unknown")
    job = client.submit(session, {"seed": 77})["id"]
    client.cancel(job)
    with pytest.raises(JobFailed) as failed:
        client.wait(job)
    assert failed.value.job["state"] == "canceled"


def test_webhooks_are_signed(client, take):
    received = []

    class Receiver(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            received.append((dict(self.headers), self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_):
            pass

    listener = http.server.HTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=listener.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{listener.server_port}/hook"
    job = client.wait(client.submit(client.upload(take)["id"], {"seed": 5}, webhook=url)["id"])["id"]
    until(lambda: received)
    headers, body = received[0]
    secret = client.webhook_secret()
    assert check_webhook(secret, headers, body) and not check_webhook(secret, headers, body + b" ")
    until(lambda: client.deliveries(job)[0]["state"] == "delivered")
    secrets = [secret, client.rotate_webhook_secret()]
    client.redeliver(job, client.deliveries(job)[0]["id"])
    until(lambda: len(received) > 1)
    assert all(check_webhook(each, *received[1]) for each in secrets) and secrets[0] != secrets[1]
    listener.shutdown()


def test_asyncio_client_solves_two_takes_at_once(server, take, tmp_path):
    async def both():
        async with AsyncClient(server) as client:
            changes = []
            jobs = await asyncio.gather(*(client.solve(take, {"seed": seed}, on_change=changes.append) for seed in (11, 12)))
            results = await asyncio.gather(*(client.result(job["id"]) for job in jobs))
            names = [name async for name, _ in client.events(jobs[0]["id"])]
            listed = [job["id"] async for job in client.jobs(state="succeeded")]
            await client.archive(jobs[0]["id"], tmp_path / "result.zip")
            await client.download(jobs[1]["id"], tmp_path / "result")
            return jobs, results, names, listed, changes

    jobs, results, names, listed, changes = asyncio.run(both())
    assert len(results) == 2 and all(len(result.people) == 2 for result in results)
    assert names[-1] == "state" and {job["id"] for job in jobs} <= set(listed) and changes
    assert zipfile.is_zipfile(tmp_path / "result.zip") and (tmp_path / "result" / "manifest.json").exists()


@pytest.mark.parametrize("example", ["solve_folder.py", "from_arrays.py", "several_takes.py"])
def test_examples_run(example, server, take):
    words = [server, str(take), str(take)] if example == "several_takes.py" else [str(take), server]
    program = ROOT / "clients" / "python" / "examples" / example
    done = subprocess.run([sys.executable, program, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout, done.stderr


def until(condition, seconds=20):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.05)
