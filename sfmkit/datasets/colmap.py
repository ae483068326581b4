"""A COLMAP model with its photographs as a data set: cameras and poses from the reconstruction."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from ..errors import InputError
from ..types import Camera
from .pair import Pair, natural_order
from .photographs import choose_pairs

CAMERAS, IMAGES = "cameras.txt", "images.txt"

# model -> its parameters; f is fx and fy
_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_DISTORTION = {
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image of a model: its name, the pose ``x_cam = R X + t``, and its camera."""

    name: str
    R: np.ndarray
    t: np.ndarray
    camera: Camera


def colmap(
    root: str | os.PathLike,
    sequences: Iterable[str] | None = None,
    *,
    images: str | os.PathLike | None = None,
) -> Iterator[Pair]:
    """Yield the pairs of a COLMAP text model, with cameras and poses.

    Args:
        root: A folder with ``cameras.txt`` and ``images.txt``, or with such a model in ``sparse``
            or ``sparse/0``.
        sequences: ``consecutive`` (the default: each image with the next one, in natural order of
            the names) or ``all`` (every two).
        images: The folder that holds the images; None: ``images`` beside or above the model, or the
            model's own folder.

    Raises:
        InputError: A file is missing or malformed, an image has a camera whose model is not
            supported, an image is missing or its name leads out of the folder, or there are fewer
            than two images.
    """
    model = model_folder(Path(root))
    if model is None:
        raise InputError(f"{root} holds no COLMAP text model ({CAMERAS} and {IMAGES})")
    posed = sorted(read_model(model), key=lambda image: natural_order(image.name))
    folder = _image_folder(model, posed, images)
    for sequence, a, b in choose_pairs(posed, sequences, str(model)):
        R = b.R @ a.R.T
        yield Pair(
            "colmap",
            sequence,
            f"{_stem(a.name)}-{_stem(b.name)}",
            folder / a.name,
            folder / b.name,
            a.camera,
            b.camera,
            R=R,
            t=b.t - R @ a.t,
        )


def model_folder(path: Path) -> Path | None:
    """The folder of the text model at or below `path`; None where there is none."""
    for folder in (path, path / "sparse", path / "sparse" / "0"):
        if (folder / CAMERAS).is_file() and (folder / IMAGES).is_file():
            return folder
    return None


def read_model(model: Path) -> list[PosedImage]:
    """The images of a text model, in the order of the file.

    Raises:
        InputError: A file cannot be read, or an entry is malformed; the message names the line.
    """
    entries: dict[str, tuple[int, list[str]]] = {}
    for number, line in _lines(model / CAMERAS):
        if words := line.split():
            entries[words[0]] = (number, words)
    cameras: dict[str, Camera] = {}
    posed: dict[str, PosedImage] = {}
    image_line = True  # every second line lists 2-D points and may be empty
    for number, line in _lines(model / IMAGES):
        if not image_line:
            image_line = True
            continue
        if not line.strip():
            continue
        image_line = False
        where = f"{model / IMAGES}, line {number}"
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise InputError(f"{where}: an image has 10 fields, not {len(words)}")
        R, t = _pose(words[1:8], where)
        if words[8] not in cameras:
            if words[8] not in entries:
                raise InputError(f"{where}: there is no camera {words[8]} in {CAMERAS}")
            cameras[words[8]] = _camera(*entries[words[8]], model)
        name = words[9].strip()
        _check_inside(name, where)
        if name in posed:
            raise InputError(f"{where}: the image {name} is listed twice")
        posed[name] = PosedImage(name, R, t, cameras[words[8]])
    return list(posed.values())


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines without comments."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path} cannot be read: {reason}") from None
    for number, line in enumerate(lines, start=1):
        if not line.startswith("#"):
            yield number, line


def _camera(number: int, words: list[str], model: Path) -> Camera:
    """Parse ``ID MODEL WIDTH HEIGHT PARAMETERS``.

    COLMAP's pixel centres are at half-integers, ours at integers.
    """
    where = f"{model / CAMERAS}, line {number}"
    if len(words) < 4 or words[1] not in _MODELS:
        raise InputError(
            f"{where}: the camera '{' '.join(words[:2])[:60]}' is not supported; "
            f"export the model with one of {', '.join(_MODELS)}"
        )
    names = _MODELS[words[1]]
    if len(words) != 4 + len(names):
        raise InputError(f"{where}: {words[1]} has {len(names)} parameters, not {len(words) - 4}")
    try:
        size = (int(words[2]), int(words[3]))
        p = dict(zip(names, (float(word) for word in words[4:]), strict=True))
        fx, fy = (p.get("f", p.get(f)) for f in ("fx", "fy"))
        K = np.array([[fx, 0, p["cx"] - 0.5], [0, fy, p["cy"] - 0.5], [0, 0, 1]], dtype=np.float64)
        lens = "fisheye" if words[1] == "OPENCV_FISHEYE" else "opencv"
        distortion = np.array([p.get(name, 0.0) for name in _DISTORTION[lens]])
        return Camera(K, size, distortion, model=lens)  # type: ignore[arg-type]
    except (InputError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from None


def _pose(words: list[str], where: str) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) and (3,) of the quaternion w, x, y, z and the translation."""
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    norm = np.linalg.norm(numbers[:4])
    if not np.isfinite(numbers).all() or not 0 < norm < np.inf:
        raise InputError(f"{where}: the pose is not finite or its quaternion is zero")
    w, x, y, z = numbers[:4] / norm
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return R, numbers[4:]


def _check_inside(name: str, where: str) -> None:
    """Raises InputError for a name that leads out of the images' folder."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or ":" in path.parts[0] or "\0" in name:
        raise InputError(f"{where}: the image name {name!r} leads out of the folder of the images")


def _image_folder(
    model: Path, posed: Sequence[PosedImage], images: str | os.PathLike | None
) -> Path:
    """The folder that holds all images of the model.

    Raises:
        InputError: None of the candidates holds them.
    """
    beside = [model / "images", model.parent / "images", model.parent.parent / "images", model]
    candidates = beside if images is None else [Path(images)]
    missing = ""
    for folder in candidates:
        absent = [image.name for image in posed if not (folder / image.name).is_file()]
        if not absent:
            return folder
        missing = missing or f"{absent[0]}, which is not in {folder}"
    raise InputError(f"the model in {model} names {missing}; give the folder of the images")


def _stem(name: str) -> str:
    return str(PurePosixPath(name.replace("\\", "/")).with_suffix(""))
