"""COLMAP models as little-endian binary: ``cameras.bin``, ``images.bin``, ``points3D.bin``.

The layout is that of COLMAP's ``src/colmap/scene/reconstruction_io_binary.cc``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...errors import InputError
from .cameras import MODELS, ColmapCamera, from_colmap, to_colmap
from .model import ColmapImage, ColmapModel, ColmapPoint, Images, check_pose, quaternion

_BY_NUMBER = {number: name for name, (number, _, _) in MODELS.items()}
_OBSERVATION = np.dtype([("xy", "<f8", 2), ("point", "<i8")])  # no point is 2^64 - 1, -1 as signed
_TRACK = np.dtype("<u4")


class _Bytes:
    """A sequential reader of the bytes of a file."""

    def __init__(self, path: Path):
        self.name = str(path)
        try:
            self.data = path.read_bytes()
        except FileNotFoundError:
            raise InputError(f"there is no file {path}") from None
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
        self.position = 0

    def take(self, count: int) -> bytes:
        if count > len(self.data) - self.position:
            raise InputError("the file ends early")
        self.position += count
        return self.data[self.position - count : self.position]

    def unpack(self, layout: str) -> tuple:
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def text(self) -> str:
        """Read a text that ends with a zero byte."""
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise InputError("a name does not end")
        try:
            return self.take(end + 1 - self.position)[:-1].decode()
        except UnicodeDecodeError:
            raise InputError("a name is not UTF-8") from None

    @contextmanager
    def entries(self) -> Iterator[range]:
        """Yield the numbers of the entries; add file name and position to an InputError."""
        try:
            (count,) = self.unpack("Q")
            yield range(min(count, len(self.data) + 1))
        except InputError as error:
            raise InputError(f"{self.name}, byte {self.position}: {error}") from None


def read_binary(folder: Path, observations: bool) -> ColmapModel:
    points = folder / "points3D.bin"
    return ColmapModel(
        _read_cameras(folder / "cameras.bin"),
        _read_images(folder / "images.bin", observations),
        _read_points(points) if observations and points.is_file() else {},
    )


def _read_cameras(path: Path) -> dict[int, ColmapCamera]:
    file = _Bytes(path)
    cameras = {}
    with file.entries() as entries:
        for _ in entries:
            key, number, w, h = file.unpack("IiQQ")
            if number not in _BY_NUMBER:
                raise InputError(f"the camera model {number} is not one of COLMAP's")
            name = _BY_NUMBER[number]
            cameras[key] = ColmapCamera(name, (w, h), file.unpack(f"{len(MODELS[name][1])}d"))
    return cameras


def _read_images(path: Path, observations: bool) -> dict[int, ColmapImage]:
    file = _Bytes(path)
    images = Images()
    with file.entries() as entries:
        for _ in entries:
            key, *pose, camera_id = file.unpack("I7dI")
            R, t = check_pose(np.array(pose[:4]), np.array(pose[4:]))
            name = file.text()
            (count,) = file.unpack("Q")
            seen = np.frombuffer(file.take(count * _OBSERVATION.itemsize), _OBSERVATION)
            image = ColmapImage(name, camera_id, R, t)
            if observations:
                if not np.isfinite(seen["xy"]).all():
                    raise InputError(f"an observation of the image {name[:80]} is not finite")
                xy, ids = from_colmap(seen["xy"]), seen["point"].astype(np.int64)
                image = ColmapImage(name, camera_id, R, t, xy, ids)
            images.add(key, image)
    return images


def _read_points(path: Path) -> dict[int, ColmapPoint]:
    file = _Bytes(path)
    points = {}
    with file.entries() as entries:
        for _ in entries:
            key, x, y, z, r, g, b, error, length = file.unpack("Q3d3BdQ")
            xyz = np.array([x, y, z])
            if not np.isfinite(xyz).all():
                raise InputError(f"the point {key} is not finite")
            track = np.frombuffer(file.take(length * 2 * _TRACK.itemsize), _TRACK)
            pairs = track.reshape(-1, 2).astype(np.int64)
            points[key] = ColmapPoint(xyz, (r, g, b), error, pairs)
    return points


def write_binary(folder: Path, model: ColmapModel) -> None:
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(model.cameras)))
        for key, camera in model.cameras.items():
            file.write(struct.pack("<IiQQ", key, MODELS[camera.model][0], *camera.size_wh))
            file.write(struct.pack(f"<{len(camera.params)}d", *camera.params))
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(model.images)))
        for key, image in model.images.items():
            pose = (*quaternion(image.R), *image.t)
            file.write(struct.pack("<I7dI", key, *pose, image.camera_id))
            file.write(image.name.encode() + b"\0" + struct.pack("<Q", len(image.xy)))
            seen = np.empty(len(image.xy), _OBSERVATION)
            seen["xy"], seen["point"] = to_colmap(image.xy), image.point_id
            file.write(seen.tobytes())
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(model.points)))
        for key, point in model.points.items():
            head = (key, *point.xyz, *point.rgb, point.error, len(point.track))
            file.write(struct.pack("<Q3d3BdQ", *head) + point.track.astype(_TRACK).tobytes())
