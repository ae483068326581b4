"""COLMAP models as text: ``cameras.txt``, ``images.txt``, ``points3D.txt``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import InputError
from .cameras import from_colmap, read_camera_list, to_colmap
from .model import ColmapImage, ColmapModel, ColmapPoint, Images, check_pose, quaternion
from .text_files import TextFile


def read_text(folder: Path, observations: bool) -> ColmapModel:
    points = folder / "points3D.txt"
    return ColmapModel(
        read_camera_list(TextFile.read(folder / "cameras.txt")),
        _read_images(folder / "images.txt", observations),
        _read_points(points) if observations and points.is_file() else {},
    )


def _read_images(path: Path, observations: bool) -> dict[int, ColmapImage]:
    """Read two lines per image: the pose with the name, and the observations.

    The name is the rest of the first line; the second line may be empty.
    """
    file = TextFile.read(path)
    images = Images()
    lines = file.numbered()
    for number, line in lines:
        if not line:
            continue  # blank lines before an image
        with file.at(number):
            words = line.split(maxsplit=9)
            if len(words) < 10:
                raise InputError("an image is ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
            key, camera_id = file.whole(words[0]), file.whole(words[8])
            pose = np.array([file.number(word) for word in words[1:8]])
            R, t = check_pose(pose[:4], pose[4:])
            images.add(key, ColmapImage(words[9], camera_id, R, t))
        number, line = next(lines, (number + 1, ""))
        if observations:
            with file.at(number):
                xy, ids = _observations(line, file)
            images[key] = replace(images[key], xy=xy, point_id=ids)
    return images


def _observations(line: str, file: TextFile) -> tuple[np.ndarray, np.ndarray]:
    words = line.split()
    if len(words) % 3:
        raise InputError("observations are triples X Y POINT3D_ID; one line per image is needed")
    xy = np.array([[file.number(a), file.number(b)] for a, b in zip(words[::3], words[1::3])])
    if not np.isfinite(xy).all():
        raise InputError("an observation is not finite")
    ids = np.array([file.whole(word) for word in words[2::3]], dtype=np.int64)
    return from_colmap(xy.reshape(-1, 2)), ids


def _read_points(path: Path) -> dict[int, ColmapPoint]:
    file = TextFile.read(path)
    points: dict[int, ColmapPoint] = {}
    for number, words in file.lines():
        with file.at(number):
            if len(words) < 8 or len(words) % 2:
                raise InputError("a point is ID X Y Z R G B ERROR and pairs IMAGE_ID POINT2D_IDX")
            key = file.whole(words[0])
            xyz = np.array([file.number(word) for word in words[1:4]])
            rgb = tuple(file.whole(word) for word in words[4:7])
            if not np.isfinite(xyz).all() or not all(0 <= c <= 255 for c in rgb):
                raise InputError("a point needs finite coordinates and colours from 0 to 255")
            track = np.array([file.whole(word) for word in words[8:]], np.int64).reshape(-1, 2)
            points[key] = ColmapPoint(xyz, rgb, file.number(words[7]), track)  # type: ignore[arg-type]
    return points


def write_text(folder: Path, model: ColmapModel) -> None:
    _write(
        folder / "cameras.txt",
        "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
        (f"{key} {camera.line()}" for key, camera in model.cameras.items()),
    )
    _write(
        folder / "images.txt",
        "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME / POINTS2D[] as X Y POINT3D_ID",
        (line for key, image in model.images.items() for line in _image_lines(key, image)),
    )
    _write(
        folder / "points3D.txt",
        "POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX",
        (_point_line(key, point) for key, point in model.points.items()),
    )


def _image_lines(key: int, image: ColmapImage) -> Iterator[str]:
    pose = _join([*quaternion(image.R), *image.t])
    yield f"{key} {pose} {image.camera_id} {image.name}"
    seen = zip(to_colmap(image.xy).tolist(), image.point_id.tolist())
    yield " ".join(f"{u:.17g} {v:.17g} {point}" for (u, v), point in seen)


def _point_line(key: int, point: ColmapPoint) -> str:
    r, g, b = point.rgb
    track = " ".join(str(v) for v in point.track.reshape(-1).tolist())
    return f"{key} {_join(point.xyz)} {r} {g} {b} {point.error:.9g} {track}"


def _join(values: Iterable[float]) -> str:
    return " ".join(f"{v:.17g}" for v in values)


def _write(path: Path, head: str, lines: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {head}\n")
        file.writelines(f"{line}\n" for line in lines)
