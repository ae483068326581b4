"""Cameras from what is known of them: EXIF, a file, numbers on the command line; and true poses to
compare with."""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CameraError, InputError
from ..types import Camera
from .exif import Exif
from .images import Image
from .sensors import sensor_width

FILM_DIAGONAL_MM = math.hypot(36, 24)  # the 35 mm film frame
GUESSED_FOCAL = (
    1.2  # in longest sides: a field of view of 45 degrees, between a phone's and a normal lens
)
FORMS = "fx,fy,cx,cy[,k1,k2,p1,p2,k3] in pixels, 24mm/36mm (focal length / sensor width), or a file with a 3x3 matrix"


class CameraWarning(UserWarning):
    """A camera had to be guessed or adapted; results depend on it."""


# --- EXIF


def camera_from_exif(image: Image) -> Camera:
    """The camera of a photograph from its EXIF: square pixels, principal point in the middle, no
    distortion.

    The focal length comes from the first of these that is there and makes a lens of sane angle:

    1. focal length in mm and resolution of the focal plane (FocalPlaneXResolution);
    2. the 35 mm equivalent, taken against the DIAGONAL of the frame (43.27 mm, as CIPA DCG-001
       defines it): cameras of 3:2 have the same focal length either way, for those of 4:3 the width
       (36 mm) would give 4 % less;
    3. focal length in mm and the sensor's width from :mod:`sfmkit.io.sensors`;
    4. a guess, 1.2 times the longest side, with a :class:`CameraWarning` and
       ``Camera.source == "guessed"``.

    Where EXIF tells the size at which the photograph was taken, the focal length is scaled with the
    image's longest
    side: a resized photograph keeps its angle of view.
    """
    w, h = image.size_wh
    exif = image.exif or Exif()
    taken = _taken_size(exif, image)
    for source, focal_at_taken in _focal_candidates(exif, taken):
        focal = focal_at_taken * max(w, h) / max(taken)
        if 0.1 <= focal / max(w, h) <= 50:  # 157 degrees to 1.1 degrees across
            return _centred(focal, image.size_wh, f"exif: {source}")
    focal = GUESSED_FOCAL * max(w, h)
    warnings.warn(
        f"the focal length of {image.name} is GUESSED as {focal:.0f} px ({GUESSED_FOCAL} x the longest side): the EXIF "
        f"tells none; pose and cloud are as wrong as this guess. Give the camera (--intrinsics): {FORMS}",
        CameraWarning,
        stacklevel=2,
    )
    return _centred(focal, image.size_wh, "guessed")


def _taken_size(exif: Exif, image: Image) -> tuple[int, int]:
    """The size at which the photograph was taken, where EXIF tells, else the image's own; in either
    order."""
    if exif.size_wh is None:
        return image.size_wh
    # Some software swaps the two numbers, so only their ratio counts.
    if not _same_shape(sorted(exif.size_wh), sorted(image.size_wh)):
        warnings.warn(
            f"{image.name} was cropped: it has {image.size_wh[0]} x {image.size_wh[1]} pixels and EXIF says "
            f"{exif.size_wh[0]} x {exif.size_wh[1]}. The camera from EXIF may be off; give it (--intrinsics): {FORMS}",
            CameraWarning,
            stacklevel=3,
        )
    return exif.size_wh


def _same_shape(size1: Any, size2: Any) -> bool:
    """Whether two sizes have one aspect ratio, to 1 % or the rounding of a pixel."""
    (w1, h1), (w2, h2) = size1, size2
    return abs(w1 * h2 - w2 * h1) <= max(0.01 * w1 * h2, w1, h1, w2, h2)


def _focal_candidates(exif: Exif, taken: tuple[int, int]) -> list[tuple[str, float]]:
    """(where from, focal length in pixels of the photograph as taken), in order of trust."""
    found = []
    if exif.focal_mm and exif.focal_plane_resolution:
        found.append(("focal plane resolution", exif.focal_mm * exif.focal_plane_resolution[0]))
    if exif.focal_35mm:
        focal = exif.focal_35mm / FILM_DIAGONAL_MM * math.hypot(*taken)
        found.append((f"{exif.focal_35mm:g} mm equivalent, by the diagonal", focal))
    width = sensor_width(exif.make, exif.model)
    if exif.focal_mm and width:
        name = f"{exif.focal_mm:g} mm on the {width:g} mm wide sensor of {exif.model}"
        found.append((name, exif.focal_mm / width * max(taken)))
    return found


def _centred(focal: float, size_wh: tuple[int, int], source: str) -> Camera:
    w, h = size_wh
    return Camera(
        np.array([[focal, 0, (w - 1) / 2], [0, focal, (h - 1) / 2], [0, 0, 1]]),
        size_wh,
        source=source,
    )


# --- given intrinsics


def parse_intrinsics(text: str | os.PathLike, size_wh: tuple[int, int]) -> Camera:
    """The camera that a text describes, for an image of `size_wh` pixels.

    Args:
        text: one of

            - ``fx,fy,cx,cy`` with up to five more numbers ``k1,k2,p1,p2,k3``: pixels, the centre of
              the top-left pixel at (0, 0), OpenCV's distortion;
            - ``24mm/36mm``: focal length and width of the sensor along the image's longest side,
              the principal point in the middle;
            - a file with a 3x3 matrix of numbers parted by spaces or commas (a 3x4 one whose last
              column is zero will do), optionally followed by a line of distortion, with comments
              from ``#`` on; or with one line as above;
            - a ``.camera`` file of the EPFL data sets (matrix, zeros, R, C, size), whose matrix and
              size are used;
            - a JSON file ``{"K": 3x3, "size_wh": [w, h], "distortion": [k1, k2, p1, p2, k3]}``, the
              last two optional.

    A file that states its size is adapted with a :class:`CameraWarning` to an image of the same
    shape and another size.

    Raises:
        CameraError: no such file, a number that is none, another shape, intrinsics that no camera
            can have, or a size of another shape than the image's.
    """
    text = os.fspath(text).strip()
    millimetres = re.fullmatch(r"([^/]+?)\s*mm\s*/\s*([^/]+?)\s*mm", text)
    if millimetres:
        focal, width = (_number(v, text) for v in millimetres.groups())
        if not (focal > 0 and width > 0 and math.isfinite(focal / width)):
            raise CameraError(f"focal length and sensor width must be positive, not {text}")
        return _centred(focal / width * max(size_wh), size_wh, "given")
    if "," in text and not os.path.exists(text):
        return _check(
            _from_numbers([_number(v, text) for v in text.split(",")], size_wh, text), text
        )
    return _check(_from_file(Path(text), size_wh), text)


def _number(word: str, where: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise CameraError(
            f"'{word.strip()}' in '{where}' is not a number; intrinsics are {FORMS}"
        ) from None


def _from_numbers(values: list[float], size_wh: tuple[int, int], where: str) -> Camera:
    if not 4 <= len(values) <= 9:
        raise CameraError(f"'{where}' holds {len(values)} numbers; intrinsics are {FORMS}")
    fx, fy, cx, cy, *distortion = values
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), size_wh, np.array(distortion))


def _from_file(path: Path, size_wh: tuple[int, int]) -> Camera:
    if not os.path.exists(path):
        raise CameraError(f"there is no file '{path}'; intrinsics are {FORMS}")
    text = _read_text(path)
    if text.lstrip().startswith("{"):
        return _from_json(_load_json(text, path), size_wh, path)
    lines = [
        line.split("#")[0].translate(str.maketrans(",;[]", "    ")).split()
        for line in text.splitlines()
    ]
    rows = [[_number(word, str(path)) for word in line] for line in lines if line]
    if len(rows) == 1:
        return _from_numbers(rows[0], size_wh, str(path))
    if [len(row) for row in rows] == [3] * 8 + [2]:  # a .camera file
        return _fit(Camera(np.array(rows[:3]), _size(rows[8], path)), size_wh, path)
    widths = {len(row) for row in rows[:3]}
    if len(rows) not in (3, 4) or widths not in ({3}, {4}):
        raise CameraError(
            f"{path} holds rows of {[len(r) for r in rows]} numbers; a 3x3 matrix is needed: {FORMS}"
        )
    if widths == {4} and any(row[3] for row in rows[:3]):
        raise CameraError(
            f"{path} holds a 3x4 matrix with a last column: a projection, not intrinsics; give the 3x3 matrix K"
        )
    return Camera(
        np.array([row[:3] for row in rows[:3]]),
        size_wh,
        np.array(rows[3] if len(rows) == 4 else []),
    )


def _from_json(data: Any, size_wh: tuple[int, int], path: Path) -> Camera:
    if not isinstance(data, dict) or "K" not in data:
        raise CameraError(
            f'{path} has no "K"; intrinsics in JSON are {{"K": 3x3, "size_wh": [w, h], "distortion": [...]}}'
        )
    K = _array(data["K"], "K", path)
    distortion = _array(data.get("distortion") or [], "distortion", path)
    if data.get("size_wh") is None:
        return Camera(K, size_wh, distortion)
    return _fit(Camera(K, _size(data["size_wh"], path), distortion), size_wh, path)


def _size(value: Any, path: Path) -> tuple[int, int]:
    w, h = size if (size := _array(value, "size", path)).shape == (2,) else (0, 0)
    if not (np.isfinite([w, h]).all() and w >= 1 and h >= 1):
        raise CameraError(
            f"the size in {path} must be two positive numbers, width and height, not {value}"
        )
    return int(w), int(h)


def _fit(camera: Camera, size_wh: tuple[int, int], path: Path) -> Camera:
    """`camera` for an image of `size_wh`, which must have its shape."""
    (w, h), (w1, h1) = size_wh, camera.size_wh
    if (w, h) == (w1, h1):
        return camera
    if not _same_shape(size_wh, camera.size_wh):
        why = (
            "the image is turned"
            if (w < h) != (w1 < h1)
            else "the image is cropped, or the camera is another's"
        )
        raise CameraError(
            f"{path} is for {w1} x {h1} pixels and the image has {w} x {h}: {why}; give K for this image"
        )
    warnings.warn(
        f"{path} is for {w1} x {h1} pixels; its focal length and principal point were scaled to the image's {w} x {h}",
        CameraWarning,
        stacklevel=4,
    )
    return camera.scaled(size_wh)


def _check(camera: Camera, where: str) -> Camera:
    """Warn of intrinsics that a camera could have and hardly any does."""
    (cx, cy), (w, h) = camera.K[:2, 2], camera.size_wh
    if abs(cx - (w - 1) / 2) > 0.25 * w or abs(cy - (h - 1) / 2) > 0.25 * h:
        doubt = f"the principal point ({cx:g}, {cy:g}) is far off the middle of the {w} x {h} image; another size's K?"
    elif not 0.1 <= camera.K[0, 0] / max(w, h) <= 50:
        doubt = (
            f"the focal length {camera.K[0, 0]:g} is odd for a {w} x {h} image; is it in pixels?"
        )
    else:
        return camera
    warnings.warn(f"{where}: {doubt}", CameraWarning, stacklevel=3)
    return camera


# --- true poses


def read_truth(
    source: str | os.PathLike,
    image1: str | os.PathLike | None = None,
    image2: str | os.PathLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The true pose of camera 2 from camera 1, ``X2 = R X1 + t``.

    Args:
        source: a JSON file with ``"R"`` (3x3) and ``"t"`` (3); two ``.camera`` files of the EPFL
            data sets as ``A.camera,B.camera``; or a folder of such files, named ``<image>.camera``.
        image1, image2: the photographs, to find their files in a folder.

    Returns:
        R (3, 3) and t (3,) float64, t in the source's units.

    Raises:
        InputError: no such file, another content, or an R that is no rotation.
    """
    text = os.fspath(source)
    path = Path(text)
    if path.is_dir():
        if image1 is None or image2 is None:
            raise InputError(
                f"{path} is a folder of poses: the names of both images are needed to choose from it"
            )
        files = [path / f"{Path(image).name}.camera" for image in (image1, image2)]
        return _relative(*(_read_pose(file) for file in files))
    if "," in text and not os.path.exists(text):
        files = [Path(part.strip()) for part in text.split(",")]
        if len(files) != 2:
            raise InputError(
                f"'{text}' names {len(files)} files; the truth is two .camera files A,B"
            )
        return _relative(*(_read_pose(file) for file in files))
    data = _load_json(_read_text(path), path)
    if not isinstance(data, dict) or not {"R", "t"} <= data.keys():
        raise InputError(f'{path} must hold {{"R": 3x3, "t": 3}} with X2 = R X1 + t')
    R, t = _array(data["R"], "R", path), _array(data["t"], "t", path).reshape(-1)
    return _rotation(R, path), _vector(t, path)


def _read_pose(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rotation camera-to-world and centre of an EPFL ``.camera`` file: ``x_cam = R^T (X - C)``."""
    rows = [
        [_number(word, str(path)) for word in line.split()]
        for line in _read_text(path).splitlines()
        if line.split()
    ]
    if [len(row) for row in rows] != [3] * 8 + [2]:
        raise InputError(
            f"{path} is no .camera file: it needs K (3 rows), a row of zeros, R (3 rows), C, and the size"
        )
    return _rotation(np.array(rows[4:7]), path), _vector(np.array(rows[7]), path)


def _relative(
    pose1: tuple[np.ndarray, np.ndarray], pose2: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """``X = R1 X1 + C1`` in ``X2 = R2^T (X - C2)``."""
    (R1, C1), (R2, C2) = pose1, pose2
    return R2.T @ R1, R2.T @ (C1 - C2)


def _rotation(R: np.ndarray, path: Path) -> np.ndarray:
    if (
        R.shape != (3, 3)
        or not np.isfinite(R).all()
        or np.linalg.det(R) < 0
        or not np.allclose(R @ R.T, np.eye(3), atol=1e-3)
    ):
        raise InputError(
            f"R in {path} is no rotation: it must be 3x3 and orthonormal with determinant 1"
        )
    return R


def _vector(t: np.ndarray, path: Path) -> np.ndarray:
    if t.shape != (3,) or not np.isfinite(t).all():
        raise InputError(f"{path} needs a translation of three finite numbers, not {t.tolist()}")
    return t


# --- files


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise CameraError(f"there is no file {path}") from None
    except UnicodeDecodeError:
        raise CameraError(f"{path} is not a text file") from None
    except (OSError, ValueError) as error:
        raise CameraError(
            f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error


def _load_json(text: str, path: Path) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise CameraError(f"{path} is not valid JSON: {error}") from error


def _array(value: Any, name: str, path: Path) -> np.ndarray:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise CameraError(
            f'"{name}" in {path} must be numbers, all rows of one length, not {value}'
        ) from None
