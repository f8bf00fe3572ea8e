"""markers.py RESULT EXPORTS: reads the TRC files with trc-data-reader."""

import numpy as np
import trc
from result import Result, Worst

result, worst = Result(), Worst("trc")
for person in result.people:
    markers = trc.TRCData()
    markers.load(f"{result.exports}/{person['id']}.trc")
    assert markers["Markers"] == result.marker_names and markers["Units"] == "m"
    assert float(markers["DataRate"]) == result.fps and int(markers["NumFrames"]) == len(person["frames"])
    assert list(markers["Frame#"]) == person["frames"]
    places = np.stack([np.array(markers[name], float) for name in result.marker_names], 1)  # [frames, markers, 3]
    expected = result.turned("y", result.markers(person))
    known = np.isfinite(expected).all(-1)
    assert (np.isfinite(places).all(-1) == known).all()
    worst.joints(expected[known], places[known])
    steps = np.diff(markers["Time"])
    assert np.allclose(steps, 1 / result.fps, atol=2e-6), (steps.min(), steps.max())
worst.end()
