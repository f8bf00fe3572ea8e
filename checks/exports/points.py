"""points.py RESULT EXPORTS: reads the C3D files with ezc3d."""

import ezc3d
import numpy as np
from result import Result, Worst

result, worst = Result(), Worst("c3d")
start, end = result.frame_range
for person in result.people:
    c3d = ezc3d.c3d(f"{result.exports}/{person['id']}.c3d")
    point = c3d["parameters"]["POINT"]
    assert point["LABELS"]["value"] == result.marker_names and point["UNITS"]["value"] == ["mm"]
    assert (point["X_SCREEN"]["value"], point["Y_SCREEN"]["value"]) == (["+X"], ["+Z"])
    assert abs(c3d["header"]["points"]["frame_rate"] - result.fps) < 1e-4
    fits = start >= 1 and end <= 65535  # else the frames of all people count from 1 at the first one of the take
    expected = person["frames"][0] if fits else person["frames"][0] - start + 1
    assert c3d["header"]["points"]["first_frame"] + 1 == expected  # ezc3d counts from 0
    places = np.moveaxis(c3d["data"]["points"][:3], 0, -1).swapaxes(0, 1) / 1000.0  # [frames, markers, 3]
    residuals = c3d["data"]["meta_points"]["residuals"][0].T
    valid = np.array(person["valid"])
    markers = result.turned("z", result.markers(person))
    known = valid[:, None] & np.isfinite(markers).all(-1)
    assert len(places) == len(valid) and ((residuals >= 0) == known).all()
    worst.joints(markers[known], places[known])
worst.end()
