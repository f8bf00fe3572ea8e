"""colmap.py RESULT EXPORTS: reads the text model with pycolmap and compares projections."""

import numpy as np
import pycolmap
from result import Result, Worst, project

result, worst = Result(), Worst("colmap")
model = pycolmap.Reconstruction(f"{result.exports}/colmap")
assert len(model.cameras) == len(model.images) == len(result.cameras)
points = result.all_joints()
for number, camera in enumerate(result.cameras, start=1):
    image = model.images[number]
    world_to_camera = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
    lens = model.cameras[image.camera_id]
    assert (lens.width, lens.height) == (camera["width"], camera["height"])
    ours, before = project(camera, points)
    matrix = np.asarray(world_to_camera.matrix())
    in_camera = points[before] @ matrix[:, :3].T + matrix[:, 3]
    theirs = np.array([lens.img_from_cam(p) for p in in_camera], float).reshape(-1, 2)
    worst.pixels(ours, theirs - 0.5)  # COLMAP counts from the corner of the first pixel
worst.end()
