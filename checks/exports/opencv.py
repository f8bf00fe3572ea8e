"""opencv.py RESULT EXPORTS: the YAML files by OpenCV's FileStorage, the TOML files by toml, all by projectPoints."""

import cv2
import numpy as np
import toml
from result import Result, Worst, project

result, worst = Result(), Worst("opencv")
points = result.all_joints()


def compare(camera, matrix, dist, rotation, translation):
    ours, before = project(camera, points, n_distortions=len(dist))
    theirs, _ = cv2.projectPoints(points[before], np.array(rotation, float), np.array(translation, float), matrix, dist)
    worst.pixels(ours, theirs[:, 0])


for folder in ["", "easymocap/"]:
    intri = cv2.FileStorage(f"{result.exports}/{folder}intri.yml", cv2.FILE_STORAGE_READ)
    extri = cv2.FileStorage(f"{result.exports}/{folder}extri.yml", cv2.FILE_STORAGE_READ)
    node = intri.getNode("names")
    names = [node.at(i).string() for i in range(node.size())]
    assert len(names) == len(result.cameras)
    for camera, name in zip(result.cameras, names):
        read = lambda storage, key: storage.getNode(f"{key}_{name}").mat()
        assert int(intri.getNode(f"H_{name}").real()) == camera["height"]
        assert np.allclose(cv2.Rodrigues(read(extri, "R"))[0], read(extri, "Rot"))
        compare(camera, read(intri, "K"), read(intri, "dist").ravel(), read(extri, "R"), read(extri, "T"))

for file in ["Calib.toml", "calibration.toml"]:
    tables = toml.load(f"{result.exports}/{file}")
    tables.pop("metadata")
    for camera, key in zip(result.cameras, tables if file == "Calib.toml" else sorted(tables)):
        table = tables[key]
        assert table["name"] == camera["id"] and table["size"] == [camera["width"], camera["height"]]
        compare(camera, np.array(table["matrix"]), np.array(table["distortions"]), table["rotation"], table["translation"])
worst.end()
