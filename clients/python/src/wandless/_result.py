"""A result: its documents, as arrays and as tables."""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Optional, Union

if TYPE_CHECKING:
    import numpy
    import pandas

#: Number of joints of the skeleton, which are those of SMPL.
N_JOINTS = 24


class Result:
    """The documents of one result. World: right-handed, metres; `x_camera = R x_world + t`, OpenCV's camera axes."""

    FILES: ClassVar[tuple[str, ...]] = ("manifest.json", "cameras.json", "people.json", "poses3d.json", "report.json")

    def __init__(self, documents: Mapping[str, Any]):
        self.manifest: dict[str, Any] = documents["manifest.json"]
        self.cameras: list[dict[str, Any]] = documents["cameras.json"]["cameras"]
        self.up_axis: str = documents["cameras.json"]["up_axis"]
        self.fps: float = documents["people.json"]["fps"]
        self.people: list[dict[str, Any]] = documents["people.json"]["people"]
        self.poses3d: dict[str, Any] = documents["poses3d.json"]
        self.report: dict[str, Any] = documents["report.json"]

    @classmethod
    def open(cls, folder: Union[str, os.PathLike[str]]) -> Result:
        """Opens the folder of `wandless reconstruct --out`, `wandless submit --out` or `Client.download`."""
        documents = {}
        for name in cls.FILES:
            with open(os.path.join(folder, name), encoding="utf-8") as file:
                documents[name] = json.load(file)
        return cls(documents)

    @property
    def verdict(self) -> str:
        """`pass`, `warn` or `reject`; `report["quality"]["reasons"]` says why."""
        verdict: str = self.report["quality"]["verdict"]
        return verdict

    def to_numpy(self) -> dict[str, numpy.ndarray[Any, Any]]:
        """Arrays over P people, F frames and C cameras; missing numbers are NaN.

        `frames [F]` numbers of the session; `person_ids [P]`; `joints [P, F, 24, 3]` m, in the order `joint_names [24]`;
        `poses [P, F, 72]` axis-angle, SMPL's order with the root first, rad; `trans [P, F, 3]` m; `betas [P, 10]`;
        `joint_sigma_mm [P, F, 24]` standard deviations of the joints, NaN where not stated;
        `valid [P, F]` false where the pose was carried over or the person is absent; `camera_ids [C]`, `K [C, 3, 3]` px,
        `R [C, 3, 3]`, `t [C, 3]` m, `positions [C, 3]` m.
        """
        import numpy as np

        frames = sorted({frame for person in self.people for frame in person["frames"]})
        column = {frame: index for index, frame in enumerate(frames)}
        shape = (len(self.people), len(frames))
        joints = np.full((*shape, N_JOINTS, 3), np.nan)
        poses, trans = np.full((*shape, 72), np.nan), np.full((*shape, 3), np.nan)
        valid, sigmas = np.zeros(shape, bool), np.full((*shape, N_JOINTS), np.nan)
        for row, person in enumerate(self.people):
            at = [column[frame] for frame in person["frames"]]
            poses[row, at, :3] = person["global_orient"]
            poses[row, at, 3:] = person["body_pose"]
            trans[row, at] = person["transl"]
            valid[row, at] = person["valid"]
            sigmas[row, at] = person.get("joint_sigma_mm", np.nan)
        rows = {str(person["id"]): row for row, person in enumerate(self.people)}
        for frame, by_person in self.poses3d["frames"].items():
            for person, points in by_person.items():
                if person in rows and int(frame) in column:
                    filled = [[np.nan] * 3 if point is None else point for point in points]
                    joints[rows[person], column[int(frame)]] = filled
        nothing3, nothing33 = [np.nan] * 3, [[np.nan] * 3] * 3
        return {
            "frames": np.array(frames, dtype=int),
            "person_ids": np.array([person["id"] for person in self.people], dtype=int),
            "joint_names": np.array(self.poses3d["joint_names"]),
            "joints": joints, "joint_sigma_mm": sigmas, "poses": poses, "trans": trans, "valid": valid,
            "betas": np.array([person["betas"] for person in self.people]).reshape(-1, 10),
            "camera_ids": np.array([camera["id"] for camera in self.cameras]),
            "K": np.array([camera["K"] for camera in self.cameras]),
            "R": np.array([camera["R"] or nothing33 for camera in self.cameras]),
            "t": np.array([camera["t"] or nothing3 for camera in self.cameras]),
            "positions": np.array([camera["position"] or nothing3 for camera in self.cameras]),
        }

    def to_pandas(self, table: str = "joints") -> pandas.DataFrame:
        """A table: `joints` (frame, person, joint, x, y, z in m), `cameras` or `people` (one row each, with the figures of the
        report)."""
        import pandas as pd

        if table == "joints":
            names = self.poses3d["joint_names"]
            rows = [
                (int(frame), int(person), name, *(point if point is not None else (None, None, None)))
                for frame, by_person in self.poses3d["frames"].items()
                for person, points in by_person.items()
                for name, point in zip(names, points)
            ]
            columns = ["frame", "person", "joint", "x", "y", "z"]
            return pd.DataFrame(rows, columns=columns).astype({"x": float, "y": float, "z": float})
        if table == "cameras":
            wanted = ("id", "status", "n_observations", "sigma_position_mm", "sigma_angle_deg")
            listed = [{key: camera.get(key) for key in wanted} | _position(camera) for camera in self.cameras]
            return pd.DataFrame(listed)
        if table == "people":
            figures = ("id", "first_frame", "last_frame", "n_detections", "bone_length_spread", "jitter_m_per_s2")
            return pd.DataFrame([{key: person.get(key) for key in figures} for person in self.report["people"]])
        raise ValueError(f"{table!r} is not a table: use joints, cameras or people")

    def to_nwb(
        self,
        path: Union[str, os.PathLike[str]],
        start: datetime.datetime,
        identifier: Optional[str] = None,
        description: str = "markerless motion capture",
    ) -> None:
        """Writes an NWB file with the joints of all people as `ndx-pose` estimates; needs the extra `nwb`.

        `start`: time of the session's first frame, with a time zone. `identifier`: of the file; random without it.
        """
        from ._nwb import write_nwb

        write_nwb(self, path, start, identifier, description)


def _position(camera: Mapping[str, Any]) -> dict[str, Any]:
    position = camera["position"] or (None, None, None)
    return dict(zip(("x", "y", "z"), position))
