"""plot.py RESULT EXPORTS PREFIX: pictures of C3D, TRC and .mot as their own readers give them: PREFIX_{c3d,trc,mot}.png.

Points of all people in the middle frame from the front, and the angles of the knees over time; pictures to look at.
"""

import sys

import cv2
import ezc3d
import numpy as np
import opensim
import trc
from result import Result

WIDTH, HEIGHT, MARGIN = 640, 480, 30
COLOURS = [(245, 169, 90), (65, 165, 242), (123, 194, 98), (164, 119, 236)]

result, prefix = Result(), sys.argv[3]
counts = {frame: sum(frame in person["frames"] for person in result.people) for frame in range(result.frame_range[0], result.frame_range[1] + 1)}
full = [frame for frame, count in counts.items() if count == max(counts.values())]
middle = full[len(full) // 2]


def points_of_c3d(person, row):
    points = ezc3d.c3d(f"{result.exports}/{person['id']}.c3d")["data"]["points"][:3, :, row].T / 1000.0
    return points[:, [0, 2]]  # z is up


def points_of_trc(person, row):
    markers = trc.TRCData()
    markers.load(f"{result.exports}/{person['id']}.trc")
    return np.array([markers[name][row] for name in result.marker_names], float)[:, :2]  # y is up


def draw_points(read, path):
    image = np.full((HEIGHT, WIDTH, 3), 30, np.uint8)
    shown = [(i, person) for i, person in enumerate(result.people) if middle in person["frames"]]
    points = {i: read(person, person["frames"].index(middle)) for i, person in shown}
    every = np.concatenate(list(points.values()))
    low, high = np.nanmin(every, 0), np.nanmax(every, 0)
    scale = min((WIDTH - 2 * MARGIN) / (high[0] - low[0]), (HEIGHT - 2 * MARGIN) / (high[1] - low[1]))
    for i, places in points.items():
        for j, place in enumerate(places):
            if np.isfinite(place).all():
                x, y = MARGIN + (place - low) * scale
                cv2.circle(image, (round(x), round(HEIGHT - y)), 5 if j < 24 else 2, COLOURS[i % 4], -1, cv2.LINE_AA)
    cv2.imwrite(path, image)


def draw_angles(path):
    image = np.full((HEIGHT, WIDTH, 3), 30, np.uint8)
    for i, person in enumerate(result.people):
        motion = opensim.TimeSeriesTable(f"{result.exports}/{person['id']}.mot")
        angles = motion.getDependentColumn("knee_angle_r").to_numpy()
        times = np.array(motion.getIndependentColumn()) * result.fps
        x = MARGIN + times / max(result.frame_range[1] - result.frame_range[0], 1) * (WIDTH - 2 * MARGIN)
        y = HEIGHT / 2 - angles / 180.0 * (HEIGHT / 2 - MARGIN)
        cv2.polylines(image, [np.stack([x, y], -1).round().astype(np.int32)], False, COLOURS[i % 4], 1, cv2.LINE_AA)
    cv2.line(image, (MARGIN, HEIGHT // 2), (WIDTH - MARGIN, HEIGHT // 2), (90, 90, 90), 1)
    cv2.imwrite(path, image)


draw_points(points_of_c3d, f"{prefix}_c3d.png")
draw_points(points_of_trc, f"{prefix}_trc.png")
draw_angles(f"{prefix}_mot.png")
