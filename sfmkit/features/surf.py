"""SURF in torch, compatible with OpenCV's SURF, which OpenCV's wheels do not contain.

Bay, Ess, Tuytelaars, Van Gool, "Speeded-Up Robust Features (SURF)", CVIU 110 (2008). Sizes,
thresholds, angles and the order of the descriptor's numbers follow OpenCV, so its settings and
results can be reused.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from .._utils.parallel import map_on_cores
from ..errors import InputError
from ..types import Features
from .surf_descriptor import Level, descriptor, level_of, orientation, smoothed_levels
from .surf_detector import fast_hessian

CHUNK = 1024  # keypoints described at once on a CPU: their samples fit in the cache
CHUNK_ACCELERATOR = 8192
# pixels; the keypoints of a tile are described together, so that their pixels stay in the cache
TILE = 256


def surf(
    image: np.ndarray,
    *,
    hessian_threshold: float = 30.0,
    octaves: int = 4,
    layers: int = 3,
    extended: bool = False,
    upright: bool = False,
    device: torch.device | str | None = None,
) -> Features:
    """Detect and describe SURF keypoints.

    Args:
        image: (H, W) grey levels 0 to 255, uint8 or another real type, which is rounded.
        hessian_threshold: Minimum determinant of the Hessian, as in OpenCV, whose default is 100.
            Dippold & Tsai use 30.
        octaves: Number of octaves; the size of the filters doubles from one to the next.
        layers: Number of scales in an octave at which blobs are found.
        extended: Whether a descriptor has 128 numbers instead of 64.
        upright: Whether the orientation is 0 (U-SURF), which is faster, for cameras that do not
            roll.
        device: Torch device; the CPU by default.

    Returns:
        The features, strongest first. `scales` are diameters in pixels, `scores` determinants of
        the Hessian, `angles` radians, and `laplacian` is the sign of the Laplacian.

    Raises:
        InputError: The image or an option is invalid.
    """
    if not (np.isfinite(hessian_threshold) and hessian_threshold >= 0):
        raise InputError(
            f"hessian_threshold must be a number of at least 0, not {hessian_threshold}"
        )
    if octaves < 1 or layers < 1:
        raise InputError(f"octaves and layers must be at least 1, not {octaves} and {layers}")
    integral = _integral(image, device)
    blobs = fast_hessian(integral, hessian_threshold, octaves, layers)
    angle, described = _describe(integral, blobs.xy, blobs.size, None, extended, upright)
    order = torch.argsort(blobs.response, descending=True, stable=True)

    def numpy(a: Tensor) -> np.ndarray:
        return a[order].cpu().numpy()

    return Features(
        keypoints=numpy(blobs.xy),
        scales=numpy(blobs.size),
        angles=numpy(angle),
        scores=numpy(blobs.response),
        descriptors=numpy(described),
        norm="l2",
        operator="surf",
        size_wh=(integral.shape[1] - 1, integral.shape[0] - 1),
        laplacian=numpy(blobs.sign),
    )


def describe(
    image: np.ndarray,
    keypoints: np.ndarray,
    scales: np.ndarray,
    angles: np.ndarray | None = None,
    *,
    extended: bool = False,
    upright: bool = False,
    device: torch.device | str | None = None,
) -> np.ndarray:
    """Compute SURF descriptors of keypoints from another detector.

    Args:
        image: (H, W) grey levels as for :func:`surf`.
        keypoints: (N, 2) pixels.
        scales: (N,) diameters in pixels, positive.
        angles: (N,) radians from x towards y; None to compute SURF's own orientation.
        extended, device: As for :func:`surf`.
        upright: Whether to use the angle 0 for all keypoints and ignore `angles`.

    Returns:
        (N, 64 or 128) float32 descriptors of unit length, in the order of the keypoints.

    Raises:
        InputError: The arrays are invalid.
    """
    xy, size = np.asarray(keypoints, dtype=np.float32), np.asarray(scales, dtype=np.float32)
    angle = None if angles is None else np.asarray(angles, dtype=np.float32)
    shapes = [a.shape for a in (xy, size, angle) if a is not None]
    if xy.ndim != 2 or xy.shape[1] != 2 or any(shape != xy.shape[:1] for shape in shapes[1:]):
        raise InputError(
            f"keypoints must be (N, 2), scales and angles (N,); got {', '.join(map(str, shapes))}"
        )
    if not (np.isfinite(xy).all() and np.isfinite(size).all() and (size > 0).all()):
        raise InputError(
            "keypoints must be finite, scales finite and positive (diameters in pixels)"
        )
    if angle is not None and not np.isfinite(angle).all():
        raise InputError("angles must be finite (radians)")
    integral = _integral(image, device)

    def tensor(a: np.ndarray) -> Tensor:
        return torch.tensor(a, device=integral.device)

    given = None if angle is None else tensor(angle)
    return _describe(integral, tensor(xy), tensor(size), given, extended, upright)[1].cpu().numpy()


def _integral(image: np.ndarray, device: torch.device | str | None) -> Tensor:
    """Compute the (H + 1, W + 1) int32 integral image.

    Its sums wrap around 2^32, which leaves the differences correct.
    """
    image = np.asarray(image)
    if image.ndim != 2 or image.size == 0:
        raise InputError(f"SURF needs a grey image (H, W), not shape {image.shape}")
    if image.dtype != np.uint8:
        if (
            image.dtype.kind not in "fiu"
            or not np.isfinite(image).all()
            or image.min() < 0
            or image.max() > 255
        ):
            raise InputError(
                f"SURF needs grey levels from 0 to 255; got {image.dtype} values outside"
            )
        image = np.rint(image).astype(np.uint8)
    return torch.from_numpy(cv2.integral(image, sdepth=cv2.CV_32S)).to(device or "cpu")


def _describe(
    integral: Tensor, xy: Tensor, size: Tensor, angle: Tensor | None, extended: bool, upright: bool
) -> tuple[Tensor, Tensor]:
    """Compute angles (N,), unless they are given, and descriptors (N, 64 or 128)."""
    find_angle = angle is None and not upright
    angles = xy.new_zeros(len(xy)) if angle is None or upright else angle.clone()
    described = xy.new_zeros(len(xy), 128 if extended else 64)
    if not len(xy):
        return angles, described
    levels = smoothed_levels(integral, int(level_of(size).max()) + 1)
    level = level_of(size).clamp(max=len(levels) - 1)
    tile = (xy / (TILE << level)[:, None]).long().clamp_(0, (1 << 20) - 1)
    order = torch.argsort((level << 40) + (tile[:, 1] << 20) + tile[:, 0])

    def fill(part: tuple[Level, Tensor]) -> None:
        source, rows = part
        if find_angle:
            angles[rows] = orientation(integral, xy[rows], size[rows])
        described[rows] = descriptor(source, xy[rows], size[rows], angles[rows], extended)

    chunk = CHUNK if integral.device.type == "cpu" else CHUNK_ACCELERATOR
    same_level = order.split(torch.bincount(level, minlength=len(levels)).tolist())
    parts = [
        (source, rows)
        for source, group in zip(levels, same_level)
        for rows in group.split(chunk)
        if len(rows)
    ]
    map_on_cores(fill, parts)
    return angles, described
