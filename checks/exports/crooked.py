"""crooked.py RESULT: makes a result hard for every format: crooked lenses, and a person who comes, is lost, and goes."""

import json
import sys

path = f"{sys.argv[1]}/cameras.json"
with open(path) as file:
    cameras = json.load(file)
lenses = [
    (17.5, -9.25, 1.0, [0.0] * 5),
    (-20.0, 4.0, 1.02, [-0.1, 0.02, 0.001, -0.0005, 0.0]),
    (3.0, 11.0, 0.98, [-0.1, 0.02, 0.001, -0.0005, 0.004]),
    (0.0, 0.0, 1.0, [0.0] * 5),
]
for i, camera in enumerate(cameras["cameras"]):
    dx, dy, aspect, dist = lenses[i % len(lenses)]
    camera["K"][0][2] += dx
    camera["K"][1][2] += dy
    camera["K"][1][1] *= aspect
    camera["dist"] = dist
with open(path, "w") as file:
    json.dump(cameras, file)

path = f"{sys.argv[1]}/people.json"
with open(path) as file:
    people = json.load(file)
person = people["people"][-1]
for key in ["frames", "global_orient", "body_pose", "transl", "valid"]:
    person[key] = person[key][12:70]
person["valid"][20:25] = [False] * 5
with open(path, "w") as file:
    json.dump(people, file)
