"""crooked.py RESULT: makes a result difficult for every format: asymmetric lenses, and a person with missing frames."""

import json
import sys

path = f"{sys.argv[1]}/cameras.json"
with open(path) as file:
    cameras = json.load(file)
lenses = [
    (17.5, -9.25, 1.0, [0.0] * 5, None),
    (-20.0, 4.0, 1.02, [-0.1, 0.02, 0.001, -0.0005, 0.0], None),
    (3.0, 11.0, 0.98, [-0.1, 0.02, 0.001, -0.0005, 0.004], None),
    (0.0, 0.0, 1.0, [0.0] * 5, None),
    (-6.0, 2.5, 1.01, [0.2, 0.05, 0.001, -0.0005, 0.004, 0.3, 0.04, 0.002], "rational"),
    (9.0, -4.5, 0.99, [-0.02, 0.004, -0.001, 0.0001], "fisheye"),
]
for i, camera in enumerate(cameras["cameras"]):
    dx, dy, aspect, dist, model = lenses[i % len(lenses)]
    camera["K"][0][2] += dx
    camera["K"][1][2] += dy
    camera["K"][1][1] *= aspect
    camera["dist"] = dist
    if model is not None:
        camera["distortion_model"] = model
with open(path, "w") as file:
    json.dump(cameras, file)

path = f"{sys.argv[1]}/people.json"
with open(path) as file:
    people = json.load(file)
person = people["people"][-1]
for key in ["frames", "global_orient", "body_pose", "transl", "valid", "joint_sigma_mm"]:
    if key in person:
        person[key] = person[key][12:70]
for hand in person.get("hands", {}).values():
    for key, frames in hand.items():
        hand[key] = frames[12:70]
person["valid"][20:25] = [False] * 5
with open(path, "w") as file:
    json.dump(people, file)
