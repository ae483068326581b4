"""COLMAP's camera models and their conversion to and from :class:`~sfmkit.types.Camera`.

The centre of the top-left pixel is (0.5, 0.5) in COLMAP and (0, 0) in sfmkit. Only
:func:`to_colmap` and :func:`from_colmap` convert between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...types import Camera
from .text_files import TextFile

MAX_SIDE = 1_000_000  # pixels; a larger number is a damaged file
_RADIAL = ("k1", "k2", "k3", "k4")
_PINHOLE = ("fx", "fy", "cx", "cy")
_SIMPLE = ("f", "cx", "cy")
_OPENCV = ("k1", "k2", "p1", "p2")

# Name -> (number in binary files, parameters, model of sfmkit or None if not supported).
# Source: COLMAP 4, src/colmap/sensor/models.h.
MODELS: dict[str, tuple[int, tuple[str, ...], str | None]] = {
    "SIMPLE_PINHOLE": (0, _SIMPLE, "opencv"),
    "PINHOLE": (1, _PINHOLE, "opencv"),
    "SIMPLE_RADIAL": (2, (*_SIMPLE, "k1"), "opencv"),
    "RADIAL": (3, (*_SIMPLE, "k1", "k2"), "opencv"),
    "OPENCV": (4, (*_PINHOLE, *_OPENCV), "opencv"),
    "OPENCV_FISHEYE": (5, (*_PINHOLE, *_RADIAL), "fisheye"),
    "FULL_OPENCV": (6, (*_PINHOLE, *_OPENCV, "k3", "k4", "k5", "k6"), "opencv"),
    "FOV": (7, (*_PINHOLE, "omega"), None),
    "SIMPLE_RADIAL_FISHEYE": (8, (*_SIMPLE, "k1"), "fisheye"),
    "RADIAL_FISHEYE": (9, (*_SIMPLE, "k1", "k2"), "fisheye"),
    "THIN_PRISM_FISHEYE": (10, (*_PINHOLE, *_OPENCV, "k3", "k4", "sx1", "sy1"), None),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        11,
        (*_PINHOLE, "k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3"),
        None,
    ),
    "SIMPLE_DIVISION": (12, (*_SIMPLE, "k"), None),
    "DIVISION": (13, (*_PINHOLE, "k"), None),
    "SIMPLE_FISHEYE": (14, _SIMPLE, "fisheye"),
    "FISHEYE": (15, _PINHOLE, "fisheye"),
    "EUCM": (16, (*_PINHOLE, "alpha", "beta"), None),
    "EQUIRECTANGULAR": (17, ("w", "h"), None),
}
SUPPORTED = tuple(name for name, (_, _, lens) in MODELS.items() if lens)


def to_colmap(x: np.ndarray) -> np.ndarray:
    """Convert pixels from the convention of sfmkit to that of COLMAP: add half a pixel."""
    return x + 0.5


def from_colmap(x: np.ndarray) -> np.ndarray:
    """Convert pixels from the convention of COLMAP to that of sfmkit: subtract half a pixel."""
    return x - 0.5


@dataclass(frozen=True)
class ColmapCamera:
    """A camera of a COLMAP file.

    Attributes:
        model: Name, a key of ``MODELS``.
        size_wh: Width and height of the image, pixels.
        params: Parameters in COLMAP's order and pixel convention.

    Raises:
        InputError: The model is unknown, the number of parameters is wrong, a parameter is not
            finite, or the size is impossible.
    """

    model: str
    size_wh: tuple[int, int]
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"the camera model '{self.model[:40]}' is not one of COLMAP's")
        names = MODELS[self.model][1]
        if len(self.params) != len(names):
            raise InputError(f"{self.model} has {len(names)} parameters, not {len(self.params)}")
        if not all(math.isfinite(v) for v in self.params):
            raise InputError(f"{self.model} needs finite parameters, not {self.params}")
        if not all(1 <= side <= MAX_SIDE for side in self.size_wh):
            raise InputError(f"an image cannot have {self.size_wh[0]} x {self.size_wh[1]} pixels")

    def camera(self) -> Camera:
        """Convert to a camera of sfmkit.

        Raises:
            InputError: sfmkit does not support the camera model, or the parameters are impossible.
        """
        _, names, lens = MODELS[self.model]
        if lens is None:
            raise InputError(
                f"the camera model {self.model} is not supported; undistort the images, or use one "
                f"of {', '.join(SUPPORTED)}"
            )
        p = dict(zip(names, self.params))
        fx, fy = p.get("f", p.get("fx", 0.0)), p.get("f", p.get("fy", 0.0))
        cx, cy = from_colmap(np.array([p["cx"], p["cy"]]))
        order = _RADIAL if lens == "fisheye" else (*_OPENCV, "k3", "k4", "k5", "k6")
        return Camera(
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
            self.size_wh,
            np.array([p.get(name, 0.0) for name in order]),
            model="fisheye" if lens == "fisheye" else "opencv",
        )

    @classmethod
    def of(cls, camera: Camera) -> ColmapCamera:
        """Convert a camera of sfmkit to the simplest sufficient camera model.

        Raises:
            InputError: The camera has skew, thin prism or tilt, which COLMAP does not support.
        """
        if camera.K[0, 1]:
            raise InputError(
                f"COLMAP's camera models have no skew, and K[0, 1] is {camera.K[0, 1]:g}"
            )
        d = [float(v) for v in camera.distortion]
        if len(d) > 8:
            raise InputError("COLMAP's camera models have neither thin prism nor tilt coefficients")
        c = to_colmap(camera.K[:2, 2])
        params = [camera.K[0, 0], camera.K[1, 1], c[0], c[1]]
        if camera.model == "fisheye":
            name, params = "OPENCV_FISHEYE", [*params, *d]
        elif any(d[4:]):
            name, params = "FULL_OPENCV", [*params, *d, *[0.0] * (8 - len(d))]
        elif any(d):
            name, params = "OPENCV", [*params, *d[:4]]
        else:
            name = "PINHOLE"
        return cls(name, camera.size_wh, tuple(float(v) for v in params))

    def line(self) -> str:
        """Return ``MODEL WIDTH HEIGHT PARAMS[]``, the format of ``cameras.txt``."""
        params = " ".join(f"{v:.17g}" for v in self.params)
        return f"{self.model} {self.size_wh[0]} {self.size_wh[1]} {params}"


def read_camera_list(file: TextFile) -> dict[int, ColmapCamera]:
    """Read a ``cameras.txt``: lines of ``ID MODEL WIDTH HEIGHT PARAMS[]``.

    Raises:
        InputError: A line is malformed; the message contains its number.
    """
    cameras: dict[int, ColmapCamera] = {}
    for number, words in file.lines():
        with file.at(number):
            if len(words) < 4:
                raise InputError("a camera is ID MODEL WIDTH HEIGHT PARAMS[]")
            size = (file.whole(words[2]), file.whole(words[3]))
            params = tuple(file.number(word) for word in words[4:])
            if (key := file.whole(words[0])) in cameras:
                raise InputError(f"the camera {key} is listed twice")
            cameras[key] = ColmapCamera(words[1], size, params)
    return cameras
