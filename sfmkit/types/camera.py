"""A camera: intrinsics, lens distortion, and the uncertainty of both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from ..errors import CameraError

LensModel = Literal["opencv", "fisheye"]

_OPENCV_LENGTHS = (5, 8, 12, 14)
_FISHEYE_LENGTH = 4


@dataclass(frozen=True)
class IntrinsicsSigma:
    """Standard deviations of a camera's intrinsics.

    Attributes:
        focal: Standard deviation of the focal length, as a fraction of it.
        principal_point: Standard deviation of each coordinate of the principal point, pixels.
        k1: Standard deviation of the first radial distortion coefficient.

    Raises:
        CameraError: A value is negative or not finite.
    """

    focal: float
    principal_point: float
    k1: float

    def __post_init__(self) -> None:
        for name in ("focal", "principal_point", "k1"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise CameraError(f"IntrinsicsSigma.{name} must be non-negative, not {value}")

    @classmethod
    def of_source(cls, source: str, size_wh: tuple[int, int]) -> IntrinsicsSigma:
        """Return the default for intrinsics from `source`, for an image of `size_wh` pixels.

        `source` is that of a :class:`Camera`. The values are orders of magnitude; override them if
        better values are known:

        - ``given``, a calibration file and any other source: a calibration with a printed target
          achieves 0.1 % of the focal length, 0.05 % of the longest side for the principal point and
          0.002 for k1.
        - EXIF focal length with the focal plane resolution or with the sensor width: 3 %. The tag
          contains the rounded nominal focal length at infinity, and focusing and zooming change it
          by a few per cent.
        - EXIF 35 mm equivalent: 5 %. It is rounded to 1 mm (2 % at 26 mm, the wide-angle camera of
          a phone), and manufacturers relate it to the width or to the diagonal.
        - ``guessed``: 30 %. The focal lengths of ordinary lenses range from 0.7 to 2 times the
          longest side.

        Without a calibration, the principal point is assumed to be in the centre of the image,
        which is correct to about 1 % of the longest side. Distortion is assumed to be zero; |k1| is
        about 0.05 for phones and compact cameras, and 0.1 for an unknown lens.
        """
        if source.startswith("guessed"):
            focal, point, k1 = 0.3, 0.01, 0.1
        elif source.startswith("exif"):
            focal, point, k1 = 0.05 if "equivalent" in source else 0.03, 0.01, 0.05
        else:
            focal, point, k1 = 0.001, 0.0005, 0.002
        return cls(focal, point * max(size_wh), k1)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with lens distortion.

    Attributes:
        K: (3, 3) float64 intrinsics in pixels; ``K[2] == (0, 0, 1)``. The centre of the top-left
            pixel is (0, 0).
        size_wh: Width and height in pixels of the image that K belongs to.
        distortion: (D,) float64 coefficients in OpenCV's order, zeros for none. For the model
            ``opencv`` up to 5, or 8, 12 or 14 numbers ``k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty``
            (radial and tangential, rational, thin prism, tilt); the first 5, 8, 12 or 14 are
            stored, as few as contain all non-zero numbers. For ``fisheye``, the four numbers
            ``k1 k2 k3 k4`` of OpenCV's fisheye model (Kannala and Brandt 2006).
        source: Origin of the focal length: ``given``, ``exif: ...``, ``guessed``, or ``estimated,
            from ...`` with the source of the initial value.
        model: ``opencv`` or ``fisheye``; see :mod:`sfmkit.geometry.distortion`.
        sigma: Standard deviations of the intrinsics; None for the default of `source`, see
            :attr:`uncertainty`.

    Raises:
        CameraError: No camera has these intrinsics or distortion coefficients.
    """

    K: np.ndarray
    size_wh: tuple[int, int]
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))
    source: str = "given"
    model: LensModel = "opencv"
    sigma: IntrinsicsSigma | None = None

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=np.float64)
        w, h = (int(v) for v in self.size_wh)
        _check_intrinsics(K, w, h)
        d = _stored_distortion(self.distortion, self.model)
        K.flags.writeable = d.flags.writeable = False
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "size_wh", (w, h))
        object.__setattr__(self, "distortion", d)

    def __reduce__(self) -> tuple[Any, ...]:
        # The constructor restores the read-only arrays, which pickle would make writable.
        return Camera, (
            self.K,
            self.size_wh,
            self.distortion,
            self.source,
            self.model,
            self.sigma,
        )

    @property
    def has_distortion(self) -> bool:
        """Whether the camera differs from an ideal pinhole; always true for a fisheye."""
        return self.model == "fisheye" or bool(np.any(self.distortion))

    @property
    def uncertainty(self) -> IntrinsicsSigma:
        """Standard deviations of the intrinsics: `sigma`, or the default for `source`."""
        return self.sigma or IntrinsicsSigma.of_source(self.source, self.size_wh)

    def scaled(self, size_wh: tuple[int, int]) -> Camera:
        """Return the same camera for the image resized to `size_wh` pixels.

        Pixel centres are at integers: ``c' = (c + 1/2) s - 1/2``.
        """
        s = np.array(size_wh, dtype=np.float64) / self.size_wh
        K = self.K.copy()
        K[0, :2] *= s[0]
        K[1, 1] *= s[1]
        K[:2, 2] = (K[:2, 2] + 0.5) * s - 0.5
        sigma = self.sigma
        if sigma is not None:
            sigma = replace(sigma, principal_point=sigma.principal_point * float(s.max()))
        return replace(self, K=K, size_wh=size_wh, sigma=sigma)

    def tensors(self, device: torch.device | str = "cpu") -> tuple[Tensor, Tensor | None]:
        """Return K (3, 3) and the distortion (D,), None without distortion, as float64 tensors."""
        d = torch.tensor(self.distortion, device=device) if self.has_distortion else None
        return torch.tensor(self.K, device=device), d


def _check_intrinsics(K: np.ndarray, w: int, h: int) -> None:
    if K.shape != (3, 3):
        raise CameraError(f"Camera.K must be a 3x3 matrix, not shape {K.shape}")
    if not np.isfinite(K).all():
        raise CameraError("Camera.K holds NaN or infinite values")
    if not np.allclose(K[2], (0, 0, 1)) or K[1, 0] != 0:
        raise CameraError(
            "Camera.K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]]; "
            f"its last row is {K[2].tolist()}"
        )
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CameraError(
            f"Camera.K has focal lengths {K[0, 0]:g}, {K[1, 1]:g}; both must be positive (pixels)"
        )
    if w < 1 or h < 1:
        raise CameraError(f"Camera.size_wh must be positive, not ({w}, {h})")
    if not (-w <= K[0, 2] <= 2 * w and -h <= K[1, 2] <= 2 * h):
        raise CameraError(
            f"the principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies far outside the {w} x {h} image; "
            "is K for another image size?"
        )


def _stored_distortion(given: Any, model: LensModel) -> np.ndarray:
    """Return the coefficients in the stored length of `model`."""
    d = np.atleast_1d(np.asarray(given, dtype=np.float64))
    if model == "fisheye":
        if not np.any(d) and d.size <= 5:
            d = np.zeros(_FISHEYE_LENGTH)
        if d.shape != (_FISHEYE_LENGTH,) or not np.isfinite(d).all():
            raise CameraError(
                f"a fisheye camera has four finite coefficients k1 k2 k3 k4, not {d.tolist()}"
            )
        return d.copy()
    if model != "opencv":
        raise CameraError(f"Camera.model must be 'opencv' or 'fisheye', not {model!r}")
    fits = d.ndim == 1 and (len(d) <= _OPENCV_LENGTHS[0] or len(d) in _OPENCV_LENGTHS)
    if not fits or not np.isfinite(d).all():
        raise CameraError(
            "Camera.distortion must be up to 5, or 8, 12 or 14 finite numbers k1 k2 p1 p2 k3 k4 k5 "
            f"k6 s1 s2 s3 s4 tx ty, not {d.tolist()}"
        )
    used = int(np.flatnonzero(d).max(initial=-1)) + 1
    stored = np.zeros(next(n for n in _OPENCV_LENGTHS if n >= used))
    stored[:used] = d[:used]
    return stored
