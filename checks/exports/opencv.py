"""opencv.py RESULT EXPORTS: reads the YAML files with FileStorage, the TOML files with toml; all with projectPoints."""

import cv2
import numpy as np
import toml
from result import Result, Worst, project

result, worst = Result(), Worst("opencv")
points = result.all_joints()


def compare(camera, matrix, dist, rotation, translation, is_fisheye=False):
    """An unsupported distortion (listed in the manifest) must be written as none, not as another lens's numbers."""
    model = camera.get("distortion_model")
    is_held = is_fisheye if model == "fisheye" else model is None or len(dist) == 8
    assert is_held or not np.any(dist), camera["id"]
    ours, before = project(camera, points, n_distortions=len(dist) if is_held else 0)
    rotation, translation = np.array(rotation, float).reshape(3, 1), np.array(translation, float).reshape(3, 1)
    if is_fisheye:
        columns = points[before].reshape(-1, 1, 3)
        theirs, _ = cv2.fisheye.projectPoints(columns, rotation, translation, matrix, np.array(dist, float))
    else:
        theirs, _ = cv2.projectPoints(points[before], rotation, translation, matrix, dist)
    worst.pixels(ours, theirs.reshape(-1, 2))


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
        compare(camera, np.array(table["matrix"]), np.array(table["distortions"]), table["rotation"],
                table["translation"], table["fisheye"])
worst.end()
