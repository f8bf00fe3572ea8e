"""angles.py RESULT EXPORTS: reads .mot, .trc and .ik.xml with OpenSim, and the table of joint angles."""

import csv

import numpy as np
import opensim
from result import Result, Worst

ANGLE_TOLERANCE_DEG = 0.01

result, worst = Result(), Worst("angles")
for person in result.people:
    name = f"{result.exports}/{person['id']}"
    with open(f"{name}.angles.csv") as file:
        rows = list(csv.DictReader(file))
    table = {column: np.array([float(row[column] or "nan") for row in rows]) for column in rows[0]}
    assert list(table["frame"]) == person["frames"] and list(table["detected"]) == person["valid"]

    # The knee's flexion and adduction bend the leg by the angle between its bones.
    for side, hip, knee, ankle in [("l", 1, 4, 7), ("r", 2, 5, 8)]:
        thigh, shank = (person["joints"][:, a] - person["joints"][:, b] for a, b in [(hip, knee), (knee, ankle)])
        lengths = np.linalg.norm(thigh, axis=-1) * np.linalg.norm(shank, axis=-1)
        expected = (thigh * shank).sum(-1) / lengths
        angles = [np.radians(table[f"knee_{part}_{side}_deg"]) for part in ["flexion", "adduction"]]
        off = np.abs(np.arccos(np.clip(expected, -1, 1)) - np.arccos(np.cos(angles[0]) * np.cos(angles[1])))
        assert np.degrees(off).max() < 0.1, np.degrees(off).max()

    motion = opensim.TimeSeriesTable(f"{name}.mot")
    assert motion.getTableMetaDataString("inDegrees") == "yes"
    assert np.allclose(motion.getIndependentColumn(), table["time_s"], atol=1e-6)
    column = lambda label: motion.getDependentColumn(label).to_numpy()
    for theirs, ours in [("hip_flexion_l", "hip_flexion_l"), ("knee_angle_r", "knee_flexion_r"), ("pelvis_list", "pelvis_list")]:
        assert np.abs(column(theirs) - table[f"{ours}_deg"]).max() < ANGLE_TOLERANCE_DEG
    pelvis = np.stack([column(f"pelvis_t{axis}") for axis in "xyz"], -1)
    worst.joints(result.turned("y", person["joints"][:, 0]), pelvis)

    markers = opensim.TimeSeriesTableVec3(f"{name}.trc")
    assert list(markers.getColumnLabels()) == result.marker_names
    tool = opensim.InverseKinematicsTool(f"{name}.ik.xml", False)
    tasks = tool.getIKTaskSet()
    assert [tasks.get(i).getName() for i in range(tasks.getSize())] == result.joint_names
    assert tool.getMarkerDataFileName().endswith(f"{person['id']}.trc")
worst.end()
