"""Sessions in the form in which they are uploaded: from a folder, a file, bytes or documents in memory."""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any, Callable, Optional, Union

#: A folder, a zip, a JSON or an NDJSON file; the bytes of such a file; a session document; files by their names.
Source = Union[str, "os.PathLike[str]", bytes, Mapping[str, Any]]
#: Receives the sent share of an upload, 0 to 1.
OnUpload = Callable[[float], None]

CHUNK_BYTES = 1 << 18
#: Members have a fixed time, so that the same folder always gives the same bytes, and with them the same session.
MEMBER_TIME = (1980, 1, 1, 0, 0, 0)


class Body:
    """The bytes of an upload, which can be sent several times."""

    def __init__(self, file: IO[bytes], media_type: str, on_upload: Optional[OnUpload] = None):
        self.file = file
        self.media_type = media_type
        self.on_upload = on_upload
        self.length = file.seek(0, os.SEEK_END)

    def chunks(self) -> Iterator[bytes]:
        """The bytes from the start."""
        self.file.seek(0)
        sent = 0
        while chunk := self.file.read(CHUNK_BYTES):
            yield chunk
            sent += len(chunk)
            if self.on_upload:
                self.on_upload(sent / self.length)

    def close(self) -> None:
        self.file.close()


def body_of(source: Source, on_upload: Optional[OnUpload] = None) -> Body:
    """Opens a source. Ground truth (`gt/`) and hidden files of a folder are not uploaded."""
    if isinstance(source, bytes):
        return Body(io.BytesIO(source), _media_type_of(source[:2]), on_upload)
    if isinstance(source, Mapping):
        if source and all(isinstance(content, bytes) for content in source.values()):
            return Body(_zip_of((name, source[name]) for name in sorted(source)), "application/zip", on_upload)
        return Body(io.BytesIO(json.dumps(source).encode()), "application/json", on_upload)
    path = os.fspath(source)
    if os.path.isdir(path):
        return Body(_zip_of(_files_below(path)), "application/zip", on_upload)
    file = open(path, "rb")
    media_type = "application/x-ndjson" if path.endswith((".ndjson", ".jsonl")) else _media_type_of(file.read(2))
    return Body(file, media_type, on_upload)


def session_document(
    cameras: Sequence[Mapping[str, Any]],
    keypoints: Mapping[str, Any],
    fps: float,
    keypoint_convention: Union[str, Mapping[str, Any]],
    name: str = "session",
    covariances: Optional[Mapping[str, Any]] = None,
) -> dict[str, Any]:
    """A session from arrays in memory, for `upload`.

    `cameras`: `{"id", "width", "height", "K", "dist"?, "R"?, "t"?}` each. `keypoints`: by camera id an array
    `[frame][person][keypoint][x px, y px, confidence 0 to 1]`; the number of people may differ from frame to frame. A person
    whose confidences are all 0 or NaN is left out. `keypoint_convention`: a name, or a table of landmarks
    `{"name", "landmarks": [{"name", "terms": [{"joint", "weight", "offset"}]}]}`. `covariances`: of the same shape as `keypoints`,
    `[xx, xy, yy]` in px^2 each as the detector states them, NaN where it does not; cameras may be left out.
    """
    def point(values: Any) -> list[float]:
        x, y, confidence = (float(value) for value in values)
        is_missing = x != x or y != y or not confidence > 0
        return [0.0, 0.0, 0.0] if is_missing else [x, y, confidence]

    def covariance(values: Any) -> Optional[list[float]]:
        entries = [float(value) for value in values]
        return None if any(value != value for value in entries) else entries

    def people(frame: Any, stated: Any) -> list[dict[str, Any]]:
        listed: list[dict[str, Any]] = [{"keypoints": [point(values) for values in person]} for person in frame]
        if stated is not None:
            for person, of_person in zip(listed, stated):
                person["covariances"] = [covariance(values) for values in of_person]
        return [person for person in listed if any(values[2] > 0 for values in person["keypoints"])]

    def frames_of(camera: str, frames: Any) -> list[dict[str, Any]]:
        stated = (covariances or {}).get(camera)
        if stated is None:
            stated = [None] * len(frames)
        return [{"frame": n, "people": people(frame, stated[n])} for n, frame in enumerate(frames)]

    def plain(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else value

    poses = {
        camera: {"frames": frames_of(camera, frames)} for camera, frames in keypoints.items()
    }
    return {
        "name": name, "fps": fps, "n_frames": max(len(frames) for frames in keypoints.values()),
        "keypoint_convention": keypoint_convention,
        "cameras": [{key: plain(value) for key, value in camera.items()} for camera in cameras],
        "poses": poses,
    }


def _media_type_of(start: bytes) -> str:
    return "application/zip" if start == b"PK" else "application/json"


def _zip_of(files: Any) -> IO[bytes]:
    file = tempfile.TemporaryFile()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files:
            member = zipfile.ZipInfo(name, MEMBER_TIME)
            member.compress_type = zipfile.ZIP_DEFLATED
            if isinstance(content, bytes):
                archive.writestr(member, content)
            else:
                with open(content.path, "rb") as opened, archive.open(member, "w", force_zip64=True) as target:
                    while chunk := opened.read(CHUNK_BYTES):
                        target.write(chunk)
    return file


class _OnDisk:
    """A file that is read while it is packed."""

    def __init__(self, path: str):
        self.path = path


def _files_below(folder: str) -> Iterator[tuple[str, _OnDisk]]:
    names = []
    for root, folders, files in os.walk(folder):
        is_top = os.path.samefile(root, folder)
        folders[:] = [name for name in folders if not name.startswith(".") and not (is_top and name == "gt")]
        names += [os.path.relpath(os.path.join(root, name), folder) for name in files if not name.startswith(".")]
    for name in sorted(names):
        yield name.replace(os.sep, "/"), _OnDisk(os.path.join(folder, name))
