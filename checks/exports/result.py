"""A result's JSON files, and the projection of its cameras using only numpy."""

import json
import sys

import numpy as np

JOINT_TOLERANCE = 0.5e-3  # m
VERTEX_TOLERANCE = 1e-3  # m
PIXEL_TOLERANCE = 0.1


class Result:
    def __init__(self):
        self.folder, self.exports = sys.argv[1:3]
        read = lambda name: json.load(open(f"{self.folder}/{name}"))
        cameras, poses, people = read("cameras.json"), read("poses3d.json"), read("people.json")
        publish = read("manifest.json")["publish"]
        self.up, self.fps, self.frame_range = publish["up_axis"], publish["fps"], publish["frame_range"]
        self.joint_names = poses["joint_names"]
        keypoints = read("keypoints3d.json")
        self.keypoint_names, self.keypoints = keypoints["joint_names"], keypoints["frames"]
        self.marker_names = self.joint_names + [f"detected_{name}" for name in self.keypoint_names]
        self.cameras = [camera for camera in cameras["cameras"] if camera["status"] == "solved"]
        self.skin = read("vertices.json")  # of vertices.py
        self.people = []
        for person in people["people"]:
            joints = [poses["frames"][str(frame)][str(person["id"])] for frame in person["frames"]]
            joints, hands = np.array(joints), person.get("hands")  # [frames, 24, 3]
            fingers = [np.array(hands[side]["joints"]) for side in ("left", "right")] if hands else []
            self.people.append({**person, "joints": joints, "bones": np.concatenate([joints, *fingers], 1)})

    def bone_names(self, person):
        """Names of a person's joints, with SMPL-H's finger joints where hands were fitted."""
        fingers = [f"{finger}{place}" for finger in ("index", "middle", "pinky", "ring", "thumb") for place in (1, 2, 3)]
        sides = ("left", "right") if person.get("hands") else ()
        return self.joint_names + [f"{side}_{name}" for side in sides for name in fingers]

    def turned(self, up, points):
        """Converts points of the result's world to a world with another up axis."""
        x, y, z = np.moveaxis(np.asarray(points), -1, 0)
        if (self.up, up) == ("y", "z"):
            return np.stack([x, -z, y], -1)
        if (self.up, up) == ("z", "y"):
            return np.stack([x, z, -y], -1)
        return np.asarray(points)

    def markers(self, person):
        """Joints and keypoints of a person's frames, NaN where a keypoint is unknown: [frames, markers, 3]."""
        unknown = [None] * len(self.keypoint_names)
        points = [self.keypoints.get(str(frame), {}).get(str(person["id"]), unknown) for frame in person["frames"]]
        points = [[point or [np.nan] * 3 for point in frame] for frame in points]
        return np.concatenate([person["joints"], np.array(points, float)], 1)

    def all_joints(self):
        return np.concatenate([person["joints"].reshape(-1, 3) for person in self.people])


def bent(camera, x, y, n_distortions):
    """OpenCV's distortion models by their published formulas; of a polynomial the first `n_distortions` coefficients."""
    dist = list(camera["dist"])
    if n_distortions and camera.get("distortion_model") == "fisheye":
        r = np.hypot(x, y)
        angle = np.arctan(r)
        scale = sum(k * angle ** (2 * i + 1) for i, k in enumerate([1.0] + dist)) / np.where(r > 0, r, 1.0)
        return x * scale, y * scale
    k1, k2, p1, p2, k3, k4, k5, k6 = (dist[:n_distortions] + [0.0] * 8)[:8]
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def project(camera, points, n_distortions=8, principal_point=True, square=False):
    """Pixels of the points before the camera by OpenCV's published formula, and the mask of these points."""
    p = points @ np.array(camera["R"]).T + np.array(camera["t"])
    before = p[:, 2] > 0.1
    x, y = (p[before, :2] / p[before, 2:]).T
    xd, yd = bent(camera, x, y, n_distortions)
    k = np.array(camera["K"])
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    if not principal_point:
        cx, cy = (camera["width"] - 1) / 2, (camera["height"] - 1) / 2
    if square:
        fx = fy
    return np.stack([fx * xd + cx, fy * yd + cy], -1), before


class Worst:
    """The largest errors; prints them and exits with 1 beyond the bounds."""

    def __init__(self, name, joint_tolerance=JOINT_TOLERANCE):
        self.name, self.joint_tolerance = name, joint_tolerance
        self.joint, self.vertex, self.pixel, self.n = 0.0, 0.0, 0.0, 0

    def joints(self, ours, theirs):
        self.joint = max(self.joint, self.distance(ours, theirs))

    def vertices(self, ours, theirs):
        self.vertex = max(self.vertex, self.distance(ours, theirs))

    def pixels(self, ours, theirs):
        self.pixel = max(self.pixel, self.distance(ours, theirs))

    def distance(self, ours, theirs):
        ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
        assert ours.shape == theirs.shape, f"{ours.shape} and {theirs.shape}"
        self.n += ours.size // ours.shape[-1]
        return float(np.linalg.norm(ours - theirs, axis=-1).max(initial=0.0))

    def end(self):
        good = self.n > 0 and self.joint <= self.joint_tolerance and self.pixel <= PIXEL_TOLERANCE
        good = good and self.vertex <= VERTEX_TOLERANCE
        lengths = f"joints {1e3 * self.joint:.5f} mm, vertices {1e3 * self.vertex:.5f} mm"
        print(f"{'ok' if good else 'FAILED'} {self.name}: {lengths}, {self.pixel:.6f} px over {self.n} points", flush=True)
        sys.exit(0 if good else 1)
