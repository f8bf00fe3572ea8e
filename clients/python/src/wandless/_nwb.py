"""Results as Neurodata Without Borders files, with the extension `ndx-pose`."""

from __future__ import annotations

import datetime
import os
import uuid
from typing import TYPE_CHECKING, Any, Optional, Union

if TYPE_CHECKING:
    from ._result import Result

#: Parent of each joint, in SMPL's order; the root has none.
PARENTS = (None, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)


def write_nwb(
    result: Result, path: Union[str, os.PathLike[str]], start: datetime.datetime, identifier: Optional[str], description: str
) -> None:
    """See `Result.to_nwb`."""
    import ndx_pose
    import pynwb

    if start.tzinfo is None:
        raise ValueError("the start of the recording needs a time zone, such as datetime.timezone.utc")
    file = pynwb.NWBFile(
        session_description=description, identifier=identifier or str(uuid.uuid4()), session_start_time=start.astimezone(datetime.timezone.utc)
    )
    module = file.create_processing_module("behavior", "people, recovered from the 2D poses of several cameras")
    names = [str(name) for name in result.poses3d["joint_names"]]
    edges = [[parent, joint] for joint, parent in enumerate(PARENTS) if parent is not None]
    skeleton = ndx_pose.Skeleton(name="smpl", nodes=names, edges=_whole(edges))
    module.add(ndx_pose.Skeletons(skeletons=[skeleton]))
    arrays = result.to_numpy()
    first = int(arrays["frames"][0]) if len(arrays["frames"]) else 0
    for row, person in enumerate(result.people):
        module.add(_person(ndx_pose, result, arrays, row, person, names, skeleton, first))
    with pynwb.NWBHDF5IO(os.fspath(path), "w") as out:
        out.write(file)


def _person(
    ndx_pose: Any, result: Result, arrays: dict[str, Any], row: int, person: dict[str, Any], names: list[str], skeleton: Any, first: int
) -> Any:
    """The joints of one person; its frames run without holes."""
    shown = slice(person["frames"][0] - first, person["frames"][-1] - first + 1)
    series = [
        ndx_pose.PoseEstimationSeries(
            name=name,
            description=f"{name}, position of the joint's centre",
            data=arrays["joints"][row, shown, joint],
            unit="meters",
            reference_frame=f"right-handed, {result.up_axis} up, origin on the floor under the people",
            starting_time=(person["frames"][0] - first) / result.fps,
            rate=float(result.fps),
            confidence=arrays["valid"][row, shown].astype(float),
            confidence_definition="1: seen by cameras; 0: carried over by the motion prior",
        )
        for joint, name in enumerate(names)
    ]
    return ndx_pose.PoseEstimation(
        name=f"person_{person['id']}",
        pose_estimation_series=series,
        description=str(person.get("name") or f"person {person['id']}"),
        scorer="wandless",
        source_software="wandless",
        source_software_version=str(result.manifest.get("solver_version", "")),
        skeleton=skeleton,
    )


def _whole(pairs: list[list[int]]) -> Any:
    import numpy as np

    return np.array(pairs, dtype="uint8")
