"""The add-on without a window, against the real program: python test_headless.py WANDLESS (with `bpy`), or
blender --background --factory-startup --python-exit-code 1 --python test_headless.py -- WANDLESS
"""

import json
import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
import wandless  # noqa: E402  the add-on as Blender loads it

PROGRAM = os.path.abspath(sys.argv[-1])
JOINT_TOLERANCE, PIXEL_TOLERANCE = 0.5e-3, 0.1  # m, px


def run(*arguments):
    subprocess.run([PROGRAM, *map(str, arguments)], check=True, capture_output=True)


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def z_up(point, up_axis):
    x, y, z = point
    return Vector((x, -z, y)) if up_axis == "y" else Vector((x, y, z))


def check_scene(folder):
    """Bones, points and projections against the files of the result."""
    read = lambda name: json.loads((folder / name).read_text())  # noqa: E731
    publish, poses, people = read("manifest.json")["publish"], read("poses3d.json"), read("people.json")["people"]
    points, cameras = read("keypoints3d.json"), read("cameras.json")["cameras"]
    up, scene = publish["up_axis"], bpy.context.scene
    assert (scene.frame_start, scene.frame_end) == tuple(publish["frame_range"])
    assert abs(scene.render.fps / scene.render.fps_base - publish["fps"]) < 1e-6
    worst = {"joint": 0.0, "point": 0.0, "pixel": 0.0}
    for person in people:
        name = person.get("name") or f"person_{person['id']}"
        armature = bpy.data.objects[name]
        assert any(thing.type == "MESH" and thing.find_armature() == armature for thing in bpy.data.objects), name
        for frame in person["frames"][:: max(len(person["frames"]) // 12, 1)]:
            scene.frame_set(frame)
            for joint, place in zip(poses["joint_names"], poses["frames"][str(frame)][str(person["id"])]):
                found = armature.matrix_world @ armature.pose.bones[joint].head
                worst["joint"] = max(worst["joint"], (found - z_up(place, up)).length)
            for joint, place in zip(points["joint_names"], points["frames"][str(frame)][str(person["id"])]):
                if place:
                    found = bpy.data.objects[f"{name}_{joint}"].matrix_world.translation
                    worst["point"] = max(worst["point"], (found - z_up(place, up)).length)
    bpy.context.view_layer.update()
    for camera in cameras:
        scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
        for place in poses["frames"][str(publish["frame_range"][0])]["0"]:
            p = Matrix(camera["R"]) @ Vector(place) + Vector(camera["t"])
            if p.z > 0.1:
                k = camera["K"]
                ours = Vector((k[0][0] * p.x / p.z + k[0][2], k[1][1] * p.y / p.z + k[1][2]))
                seen = world_to_camera_view(scene, bpy.data.objects[camera["id"]], z_up(place, up))
                theirs = Vector((seen.x * camera["width"] - 0.5, (1.0 - seen.y) * camera["height"] - 0.5))
                worst["pixel"] = max(worst["pixel"], (ours - theirs).length)
    assert len([thing for thing in bpy.data.objects if thing.type == "CAMERA"]) == len(cameras)
    assert worst["joint"] < JOINT_TOLERANCE and worst["point"] < JOINT_TOLERANCE and worst["pixel"] < PIXEL_TOLERANCE, worst
    print(f"ok import: {worst}", flush=True)


def check_import(session, work):
    # At 29.97 frames per second the keys of people once ran away from cameras and points.
    for up, rate in (("y", ()), ("z", ()), ("y", ("--fps", "29.97"))):
        result = work / "_".join(["result", up, *rate[1:]])
        (work / "corrections.json").write_text('[{"action": "rename", "person": 0, "name": "Ada"}]')
        corrections = ("--corrections", work / "corrections.json")
        run("reconstruct", session, "--out", result, "--up", up, "--exports", "glb", *corrections, *rate)
        empty_scene()
        assert bpy.ops.wandless.import_result(directory=str(result)) == {"FINISHED"}
        check_scene(result)
        empty_scene()
        bpy.ops.wandless.import_result(directory=str(result), with_people=False, with_points=False)
        assert {thing.type for thing in bpy.data.objects} == {"CAMERA"}


def check_errors(session, work):
    """Folders that cannot be imported are explained."""
    run("reconstruct", session, "--out", work / "plain")
    for folder, expected in ((work / "plain", "--to glb"), (work, "no manifest.json")):
        empty_scene()
        try:
            bpy.ops.wandless.import_result(directory=str(folder))
            raise SystemExit(f"{folder} was imported")
        except RuntimeError as error:
            assert expected in str(error), error
    print("ok errors", flush=True)


def check_submission(session, work):
    """Submits, follows and imports; a job that is refused is explained."""
    port = 20000 + os.getpid() % 20000
    command = [PROGRAM, "serve", "--data", str(work / "data"), "--listen", f"127.0.0.1:{port}"]
    server = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        url = f"http://127.0.0.1:{port}"
        wait_for(url)
        empty_scene()
        settings = bpy.context.scene.wandless
        settings.server, settings.session, settings.options = url, str(session), '{"up_axis": "z"}'
        assert bpy.ops.wandless.submit() == {"FINISHED"}, settings.status
        assert settings.status == "imported"
        check_scene(Path(settings.result))
        for options, expected in (('{"people": 0}', "1 or more"), ("{", "not JSON")):
            settings.options = options
            try:
                bpy.ops.wandless.submit()
                raise SystemExit(f"{options} was accepted")
            except RuntimeError as error:
                assert expected in str(error), error
        print("ok submission", flush=True)
    finally:
        server.terminate()
        server.wait()


def check_cancellation(session):
    """A cancel while the session is uploaded or submitted leaves no job behind; files of 1970 are packed."""
    class Client:
        def __init__(self, when):
            self.when, self.calls = when, []

        def call(self, name):
            self.calls.append(name)
            if name == self.when:
                work.cancel()
                work.is_stopped.set()

        def upload(self, session):
            self.call("upload")
            return {"id": "session_1"}

        def submit(self, session, options):
            self.call("submit")
            return {"id": "job_1", "state": "queued", "progress": {}, "error": None}

        def cancel(self, job):
            self.calls.append("cancel")

    for when, expected in (("upload", ["upload"]), ("submit", ["upload", "submit", "cancel"])):
        work = wandless.operators.Submission(Client(when), session, {})
        work._run()
        deadline = time.monotonic() + 5
        while work.client.calls != expected and time.monotonic() < deadline:
            time.sleep(0.01)
        assert work.client.calls == expected, work.client.calls
    os.utime(session / "session.json", (0, 0))
    wandless.service.zipped(session)
    print("ok cancellation", flush=True)


def wait_for(url):
    for _ in range(300):
        try:
            urllib.request.urlopen(f"{url}/healthz", timeout=1)
            return
        except OSError:
            time.sleep(0.1)
    raise SystemExit("the service does not answer")


wandless.register()
with tempfile.TemporaryDirectory() as folder:
    folder = Path(folder)
    run("simulate", "--out", folder / "session", "--seed", "3", "--people", "2", "--views", "4", "--frames", "60")
    check_import(folder / "session", folder)
    check_errors(folder / "session", folder)
    check_submission(folder / "session", folder)
    check_cancellation(folder / "session")
wandless.unregister()
assert not hasattr(bpy.types.Scene, "wandless")
