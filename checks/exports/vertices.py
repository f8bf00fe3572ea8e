"""vertices.py RESULT BODY.npz: writes RESULT/vertices.json, skinned vertices that the scenes are compared with.

Every 97th vertex in every 6th frame of every person, in the result's world, by the forward pass of `checks/body.py`.
"""

import json
import pathlib
import sys

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
from body import vertices

result, body = pathlib.Path(sys.argv[1]), np.load(sys.argv[2], allow_pickle=False)
chosen = np.arange(0, len(body["v_template"]), 97)
people = {}
for person in json.loads((result / "people.json").read_text())["people"]:
    frames = range(0, len(person["frames"]), 6)
    rows = lambda name: np.array([person[name][i] for i in frames])
    poses = np.concatenate([rows("global_orient"), rows("body_pose")], 1)
    skin = vertices(body, np.array(person["betas"]), poses, rows("transl"))[:, chosen]
    people[person["id"]] = {person["frames"][i]: points.tolist() for i, points in zip(frames, skin)}
(result / "vertices.json").write_text(json.dumps({"vertices": chosen.tolist(), "people": people}))
