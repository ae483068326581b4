"""Calibration files of other programs.

Every reader returns a :class:`Calibration` with the centre of the top-left pixel at (0, 0). OpenCV
and ROS have the same convention; in COLMAP it is (0.5, 0.5), in MATLAB (1, 1).
"""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CameraError, InputError
from ..types import Camera
from .colmap import ColmapCamera, TextFile, read_camera_list
from .colmap.cameras import MODELS

FORMS = (
    "fx,fy,cx,cy[,k1,k2,p1,p2,k3] in pixels, 24mm/36mm (focal length / sensor width), or a file "
    "with a 3x3 matrix, JSON, YAML of OpenCV or ROS, MATLAB's text, or COLMAP's cameras.txt"
)
MAX_BYTES = 1_000_000  # largest file; calibrations with all their points are smaller
_YAML_BYTES = 300_000  # the parser takes about 10 microseconds per byte
_MAX_SIDE = 1_000_000  # pixels

# Names of the entries, in lower case and without underscores.
_MATRIX = ("k", "cameramatrix", "intrinsicmatrix", "intrinsics", "mtx")
_DISTORTION = (
    *("distortion", "distortioncoefficients", "distortioncoeffs", "distcoeffs", "dist", "d"),
)
_SIZE = ("sizewh", "resolution", "imagesize")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_LENSES = {
    **dict.fromkeys(("", "none", "pinhole", "opencv", "plumbbob", "radtan"), "opencv"),
    **dict.fromkeys(("rationalpolynomial", "radialtangential", "perspective"), "opencv"),
    **dict.fromkeys(("equidistant", "fisheye", "kannalabrandt", "equi"), "fisheye"),
}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Intrinsics read from a file.

    Attributes:
        K: (3, 3) float64 intrinsics, pixels.
        size_wh: Width and height of the image to which K refers, pixels; None if not stated.
        distortion: Coefficients of `model` as in :class:`~sfmkit.types.Camera`.
        model: ``opencv`` or ``fisheye``.
    """

    K: np.ndarray
    size_wh: tuple[int, int] | None = None
    distortion: tuple[float, ...] = ()
    model: str = "opencv"

    def camera(self, size_wh: tuple[int, int]) -> Camera:
        """Make the camera of an image of `size_wh` pixels, to which K must refer.

        Raises:
            CameraError: The intrinsics are impossible.
        """
        return Camera(self.K, size_wh, np.array(self.distortion), model=self.model)  # type: ignore[arg-type]


def read_calibration(path: Path, size_wh: tuple[int, int]) -> Calibration:
    """Read a calibration file of any of the supported kinds.

    Args:
        path: Path of the file.
        size_wh: Width and height of the image; selects a camera of a COLMAP file.

    Raises:
        CameraError: The file is missing, damaged or of an unknown format.
    """
    text = read_text(path)
    first = next((ln for ln in text.splitlines() if ln.strip() and ln.lstrip()[0] != "#"), "")
    words = first.split()
    if text.lstrip().startswith("{"):
        return _from_entries(load_json(text, path), path)
    if re.search(r"^\s*FocalLength\s*:", text, re.MULTILINE):
        return _from_matlab(_matlab_entries(text), path)
    if re.match(r"%YAML|---|[A-Za-z_]\w*\s*:", first):
        return _from_entries(_load_yaml(text, path), path)
    if len(words) > 3 and words[1] in MODELS:
        return _from_colmap(text, path, size_wh)
    return _from_rows(text, path)


# --- numbers in rows


def parse_numbers(values: list[float], where: str) -> Calibration:
    """Convert four to nine numbers ``fx fy cx cy`` with distortion, or the nine of a matrix.

    Raises:
        CameraError: The count of numbers is different.
    """
    if len(values) == 9 and (values[6:] == [0, 0, 1] or values[2::3] == [0, 0, 1]):
        return Calibration(_upper(np.array(values).reshape(3, 3)))
    if not 4 <= len(values) <= 9:
        raise CameraError(f"'{where}' holds {len(values)} numbers; intrinsics are {FORMS}")
    fx, fy, cx, cy, *distortion = values
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Calibration(K, distortion=tuple(distortion))


def number(word: str, where: str) -> float:
    """Convert `word` to a number.

    Raises:
        CameraError: It is not a number.
    """
    try:
        return float(word)
    except ValueError:
        raise CameraError(
            f"'{word.strip()[:40]}' in '{where[:200]}' is not a number; intrinsics are {FORMS}"
        ) from None


def _from_rows(text: str, path: Path) -> Calibration:
    """Read a matrix in rows with optional distortion, one row of numbers, or a ``.camera`` file."""
    lines = [line.split("#")[0] for line in text.splitlines()]
    _refuse_decimal_commas(" ".join(lines), path)
    table = str.maketrans(",;[]()", "      ")
    rows = [[number(w, str(path)) for w in line.translate(table).split()] for line in lines]
    rows = [row for row in rows if row]
    if len(rows) == 1:
        return parse_numbers(rows[0], str(path))
    if [len(row) for row in rows] == [3] * 8 + [2]:  # a .camera file
        return Calibration(np.array(rows[:3]), _size(rows[8], path))
    widths = {len(row) for row in rows[:3]}
    if len(rows) not in (3, 4) or widths not in ({3}, {4}):
        found = ", ".join(str(len(row)) for row in rows[:9]) or "no"
        raise CameraError(f"{path} holds rows of {found} numbers; a 3x3 matrix is needed: {FORMS}")
    if widths == {4} and any(row[3] for row in rows[:3]):
        raise CameraError(
            f"{path} holds a 3x4 matrix with a last column: a projection, not intrinsics; "
            "give the 3x3 matrix K"
        )
    K = _upper(np.array([row[:3] for row in rows[:3]]))
    return Calibration(K, distortion=tuple(rows[3]) if len(rows) == 4 else ())


def _refuse_decimal_commas(text: str, path: Path) -> None:
    words = re.sub(r"[\[\]();]", " ", text).split()
    if len(words) > 1 and all(re.fullmatch(r"[-+]?[0-9]+,[0-9]+", word) for word in words):
        raise CameraError(
            f"{path} has commas inside its numbers ('{words[0]}'); write decimal points, or spaces "
            "behind commas that separate numbers"
        )


def _upper(K: np.ndarray) -> np.ndarray:
    """Return K from a matrix that may be transposed, such as MATLAB's IntrinsicMatrix."""
    lower = K.shape == (3, 3) and K[:, 2].tolist() == [0, 0, 1] and K[2].tolist() != [0, 0, 1]
    return K.T.copy() if lower else K


# --- named entries: JSON and YAML


def _from_entries(data: Any, path: Path) -> Calibration:
    entries = _entries(data, path)
    if "radialdistortion" in entries:
        return _from_matlab(entries, path)
    K = _matrix(_first(entries, _MATRIX), path)
    lens = re.sub(r"[^a-z]", "", str(_first(entries, ("distortionmodel",)) or "").lower())
    if lens not in _LENSES:
        raise CameraError(f"{path} has the distortion model '{lens[:40]}', which is not supported")
    distortion = to_array(_plain(_first(entries, _DISTORTION)) or [], "distortion", path)
    size = _first(entries, _SIZE)
    if size is None and _first(entries, _WIDTH) is not None:
        size = [_first(entries, _WIDTH), _first(entries, _HEIGHT)]
    return Calibration(
        K, None if size is None else _size(size, path), _flat(distortion), _LENSES[lens]
    )


def _entries(data: Any, path: Path) -> dict[str, Any]:
    """Find the entries of a camera, by folded names; they may be nested by one level."""
    if isinstance(data, Mapping):
        folded = {str(key).replace("_", "").lower(): value for key, value in data.items()}
        if any(key in folded for key in (*_MATRIX, "radialdistortion")):
            return folded
        inner = [value for value in data.values() if isinstance(value, Mapping)]
        found = [
            value
            for value in inner
            if any(str(key).replace("_", "").lower() in _MATRIX for key in value)
        ]
        if len(found) == 1:
            return _entries(found[0], path)
        if found:
            raise CameraError(f"{path} holds {len(found)} cameras; give a file with one")
    raise CameraError(
        f'{path} has no "K" or "camera_matrix"; intrinsics in JSON are '
        '{"K": 3x3, "size_wh": [w, h], "distortion": [...]}'
    )


def _first(entries: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((entries[name] for name in names if entries.get(name) is not None), None)


def _plain(value: Any) -> Any:
    """Return the numbers of a matrix, which may be given as rows, cols and data."""
    if isinstance(value, Mapping):
        return next((v for k, v in value.items() if str(k).lower() == "data"), value)
    return value


def _matrix(value: Any, path: Path) -> np.ndarray:
    K = to_array(_plain(value), "K", path)
    if K.size == 4 and K.ndim == 1:  # fx fy cx cy of Kalibr
        return parse_numbers(K.tolist(), str(path)).K
    return _upper(K.reshape(3, 3) if K.size == 9 and K.ndim <= 2 else K)


def _flat(values: np.ndarray) -> tuple[float, ...]:
    if values.ndim > 2 or (values.ndim == 2 and 1 not in values.shape):
        raise CameraError(f"the distortion must be a list of numbers, not of shape {values.shape}")
    return tuple(values.reshape(-1).tolist())


def _load_yaml(text: str, path: Path) -> Any:
    """Load YAML without aliases and objects; the first line of OpenCV, invalid YAML, is fixed."""
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases are not supported")
            return super().compose_node(parent, index)

    def matrix(loader: Any, node: Any) -> Any:
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", matrix)
    if len(text) > _YAML_BYTES:
        raise CameraError(
            f"{path} is larger than {_YAML_BYTES:,} bytes; keep the camera matrix, the distortion "
            "and the size only"
        )
    try:
        return yaml.load(re.sub(r"\A\s*%YAML:", "%YAML ", text), Loader)
    except RecursionError:
        raise CameraError(f"{path} is nested too deeply") from None
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError) as error:
        raise CameraError(f"{path} is not valid YAML: {str(error)[:200]}") from error
    except ValueError as error:
        raise CameraError(f"{path} is not valid YAML: {str(error)[:200]}") from error


# --- MATLAB and COLMAP


def _matlab_entries(text: str) -> dict[str, Any]:
    """Parse MATLAB's printed cameraIntrinsics or cameraParameters."""
    found = re.findall(r"^\s*(\w+)\s*:\s*\[?([-+0-9.eE,; ]+)\]?\s*$", text, re.MULTILINE)
    return {name.lower(): re.split(r"[,; ]+", value.strip()) for name, value in found}


def _from_matlab(entries: Mapping[str, Any], path: Path) -> Calibration:
    """Convert from MATLAB: pixels count from 1, sizes are rows and columns, K is transposed."""
    if "focallength" in entries and "principalpoint" in entries:
        focal = to_array(entries["focallength"], "FocalLength", path).reshape(-1)
        centre = to_array(entries["principalpoint"], "PrincipalPoint", path).reshape(-1)
        skew = to_array(entries.get("skew") or 0, "Skew", path).reshape(-1)
        if (len(focal), len(centre), len(skew)) != (2, 2, 1):
            raise CameraError(f"{path} needs two focal lengths, a principal point and a skew")
        K = np.array([[focal[0], skew[0], centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    else:
        K = _matrix(_first(entries, _MATRIX), path)
        if K.shape != (3, 3):
            raise CameraError(f"{path} has neither FocalLength nor a 3x3 matrix")
    K = K - np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    radial = _flat(to_array(entries.get("radialdistortion") or [], "RadialDistortion", path))
    tangential = _flat(
        to_array(entries.get("tangentialdistortion") or [], "TangentialDistortion", path)
    )
    k, p = (*radial, 0.0, 0.0, 0.0)[:3], (*tangential, 0.0, 0.0)[:2]
    size = entries.get("imagesize")
    wh = None if size is None or not len(size) else _size(size, path)[::-1]
    return Calibration(K, wh, (k[0], k[1], p[0], p[1], k[2]))


def _from_colmap(text: str, path: Path, size_wh: tuple[int, int]) -> Calibration:
    try:
        cameras = read_camera_list(TextFile(str(path), text))
        chosen = cameras
        if len(cameras) > 1:
            chosen = {key: c for key, c in cameras.items() if c.size_wh == size_wh}
        if len({(c.model, c.params) for c in chosen.values()}) != 1:
            raise InputError(
                f"{path} holds {len(cameras)} cameras, {len(chosen)} of them for "
                f"{size_wh[0]} x {size_wh[1]} pixels; keep the line of this camera"
            )
        return _from_camera(next(iter(chosen.values())))
    except CameraError:
        raise
    except InputError as error:
        raise CameraError(str(error)) from None


def _from_camera(given: ColmapCamera) -> Calibration:
    camera = given.camera()
    return Calibration(camera.K, camera.size_wh, tuple(camera.distortion.tolist()), camera.model)


# --- files


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with or without a byte order mark, of at most MAX_BYTES.

    Raises:
        CameraError: The file is missing, unreadable, too large, or not text.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if data.startswith(b"MATLAB 5.0 MAT-file"):
            raise CameraError(
                f"{path} is a MATLAB .mat file, which is not read; in MATLAB write K as text with "
                "writematrix(params.K, 'K.txt'), and subtract 1 from the principal point"
            )
        if len(data) > MAX_BYTES:
            raise CameraError(f"{path} is larger than {MAX_BYTES:,} bytes: not a calibration")
        return data.decode("utf-8-sig")
    except FileNotFoundError:
        raise CameraError(f"there is no file {path}") from None
    except UnicodeDecodeError:
        raise CameraError(f"{path} is not a text file") from None
    except CameraError:
        raise
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise CameraError(f"{path} cannot be read: {why}") from error


def load_json(text: str, path: Path) -> Any:
    """Parse a JSON text.

    Raises:
        CameraError: The text is not JSON or nested too deeply, or a number has too many digits.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise CameraError(f"{path} is nested too deeply") from None
    except ValueError as error:
        raise CameraError(f"{path} is not valid JSON: {str(error)[:200]}") from error


def to_array(value: Any, name: str, path: Path) -> np.ndarray:
    """Convert `value` to a float64 array.

    Raises:
        CameraError: `value` contains text, rows of different lengths, or numbers beyond float64.
    """
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise CameraError(
            f'"{name}" in {path} must be numbers, all rows of one length, not {reprlib.repr(value)}'
        ) from None


def _size(value: Any, path: Path) -> tuple[int, int]:
    size = to_array(value, "size", path)
    if size.shape != (2,) or not ((size >= 1) & (size <= _MAX_SIDE)).all():
        raise CameraError(
            f"the size in {path} must be two positive numbers, width and height, not "
            f"{reprlib.repr(value)}"
        )
    return int(size[0]), int(size[1])
