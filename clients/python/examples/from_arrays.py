"""Makes a session of arrays in memory, as a detector returns them, and solves it: python3 from_arrays.py FOLDER [SERVER]

The arrays are read from a session in the native layout here; in a program they come from the detector.
"""

import json
import pathlib
import sys

import numpy as np
from wandless import Client, session_document

folder, *server = sys.argv[1:]
session = json.loads((pathlib.Path(folder) / "session.json").read_text())
keypoints = {}
for camera in session["cameras"]:
    poses = json.loads((pathlib.Path(folder) / "poses" / f"{camera['id']}.json").read_text())
    keypoints[camera["id"]] = [np.array([person["keypoints"] for person in frame["people"]]) for frame in poses["frames"]]

cameras = [{**camera, "K": np.array(camera["K"])} for camera in session["cameras"]]
document = session_document(cameras, keypoints, session["fps"], session["keypoint_convention"], name="from arrays")
with Client(*server) as client:
    result = client.result(client.solve(document)["id"])

arrays = result.to_numpy()
present = ~np.isnan(arrays["joints"][..., 0]).all(axis=2)
for person, joints, frames in zip(arrays["person_ids"], arrays["joints"], present):
    pelvis = joints[frames, 0]
    path = np.linalg.norm(np.diff(pelvis, axis=0), axis=1).sum()
    print(f"person {person}: {frames.sum()} frames, pelvis moved {path:.2f} m")
