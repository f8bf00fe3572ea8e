"""Reading of a result folder; no Blender."""

import json
from dataclasses import dataclass
from pathlib import Path


class TakeError(Exception):
    """A folder is not a result, or lacks what the import needs; the message says what to do."""


@dataclass
class Take:
    """The parts of a result that are imported. Frame numbers are those of the session, lengths are metres."""

    folder: Path
    name: str
    up_axis: str
    fps: float
    frame_range: tuple
    cameras: list
    people: list
    keypoint_names: list
    keypoints: dict  # [frame number][person id][keypoint]: position, or None

    @property
    def scene(self):
        """The file of skinned people; None where the result has none."""
        path = self.folder / "scene.glb"
        return path if path.is_file() else None


def read_json(folder, name):
    path = folder / name
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise TakeError(f"{folder} has no {name}; choose the folder of a finished result") from None
    except ValueError as error:
        raise TakeError(f"{path}: {error}; download the result again") from None


def read_take(folder):
    """Reads the result in `folder`."""
    folder = Path(folder)
    manifest = read_json(folder, "manifest.json")
    cameras = read_json(folder, "cameras.json")["cameras"]
    points = read_json(folder, "keypoints3d.json")
    publish = manifest["publish"]
    return Take(
        folder=folder,
        name=manifest["input"]["name"] or "take",
        up_axis=publish["up_axis"],
        fps=publish["fps"],
        frame_range=tuple(publish["frame_range"]),
        cameras=[camera for camera in cameras if camera["R"] is not None],
        people=read_json(folder, "people.json")["people"],
        keypoint_names=points["joint_names"],
        keypoints=points["frames"],
    )
