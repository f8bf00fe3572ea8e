"""opensim.py RESULT EXPORTS: reads the TRC files with trc-data-reader."""

import numpy as np
import trc
from result import Result, Worst

result, worst = Result(), Worst("opensim")
for person in result.people:
    markers = trc.TRCData()
    markers.load(f"{result.exports}/{person['id']}.trc")
    assert markers["Markers"] == result.joint_names and markers["Units"] == "m"
    assert float(markers["DataRate"]) == result.fps and int(markers["NumFrames"]) == len(person["frames"])
    assert list(markers["Frame#"]) == person["frames"]
    places = np.stack([np.array(markers[name], float) for name in result.joint_names], 1)  # [frames, 24, 3]
    worst.joints(result.turned("y", person["joints"]), places)
    steps = np.diff(markers["Time"])
    assert np.allclose(steps, 1 / result.fps, atol=2e-6), (steps.min(), steps.max())
worst.end()
