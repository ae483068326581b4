"""Any operator under simulated viewpoints: the image is tilted as an oblique camera would see it,
and searched again.

Operators bear changes of scale and rotation, hardly any a surface seen from the side. Simulating
the tilt on both images and pooling the features lets a pair match whose views are up to 80 degrees
apart.

Source: Morel & Yu, "ASIFT: a new framework for fully affine invariant image comparison", SIAM J.
Imaging Sciences 2009.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from ..errors import InputError
from ..types import Features

# blur against aliasing before an axis is compressed t times: this times sqrt(t² - 1), as in the
# paper
_PREFILTER = 0.8
# keypoints nearer than this many of their radii to the edge of the tilted image describe the edge
_MARGIN = 1.5


def views(tilts: int) -> Iterator[tuple[float, float]]:
    """Tilt t and rotation phi (radians) of each simulated view: ``t = sqrt(2)^k``, phi in steps of
    72°/t over half a turn."""
    yield 1.0, 0.0
    for k in range(1, tilts + 1):
        t = math.sqrt(2) ** k
        for step in range(math.ceil(180 * t / 72 - 1e-9)):
            yield t, math.radians(step * 72 / t)


def tilted(grey: np.ndarray, t: float, phi: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The view at tilt `t` in the direction `phi`.

    Returns:
        image (h, w) uint8; the (2, 3) affine map from `grey` into it; mask (h, w), 0 where it shows
        nothing.
    """
    h, w = grey.shape
    c, s = math.cos(phi), math.sin(phi)
    R = np.array([[c, -s], [s, c]])
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]]) @ R.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    turn = np.column_stack([R, -low])
    turned = cv2.warpAffine(
        grey, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    inside = cv2.warpAffine(np.full_like(grey, 255), turn, size, flags=cv2.INTER_NEAREST)
    if t == 1.0:
        return turned, turn, inside
    turned = cv2.GaussianBlur(turned, (0, 0), sigmaX=_PREFILTER * math.sqrt(t * t - 1), sigmaY=0.01)
    squeeze = np.array([[1 / t, 0, 0], [0, 1, 0.0]])
    small = (max(1, int(size[0] / t)), size[1])
    image = cv2.warpAffine(
        turned, squeeze, small, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    mask = cv2.warpAffine(inside, squeeze, small, flags=cv2.INTER_NEAREST)
    return image, np.diag([1 / t, 1.0]) @ turn, mask


def detect_affine(image: Any, operator: str, *, tilts: int = 2, **options: Any) -> Features:
    """Features of an image and of its simulated views, in the pixels of the image.

    Args:
        image, operator, options: as for :func:`sfmkit.detect`.
        tilts: steps of sqrt(2) in tilt; 2 (up to 2, a view 60 degrees off the normal) take 10
            views, 3 take 18.

    Returns:
        The features of all views. Scales are those in the image (root of the area), angles are 0:
        they mean nothing after a tilt. ``operator`` is ``affine-<operator>``.

    Raises:
        InputError: tilts out of range, and what :func:`sfmkit.detect` raises.
    """
    from .operators import _grey, detect

    if not 0 <= tilts <= 6:
        raise InputError(f"tilts must be a whole number from 0 to 6, not {tilts!r}")
    grey = _grey(image)
    h, w = grey.shape
    parts = []
    for t, phi in views(tilts):
        view, A, mask = tilted(grey, t, phi)
        f = detect(view, operator, **options)
        distance = cv2.distanceTransform(np.pad((mask > 0).astype(np.uint8), 1), cv2.DIST_L2, 3)[
            1:-1, 1:-1
        ]
        at = np.rint(f.keypoints).astype(np.int64).clip(0, (view.shape[1] - 1, view.shape[0] - 1))
        f = f.take(np.flatnonzero(distance[at[:, 1], at[:, 0]] > _MARGIN * f.scales / 2))
        xy = (f.keypoints - A[:, 2]) @ np.linalg.inv(A[:, :2]).T
        parts.append((xy.clip(0, (w - 1, h - 1)), f.scales * math.sqrt(t), f))
    fs = [f for *_, f in parts]
    laplacian = None if fs[0].laplacian is None else np.concatenate([f.laplacian for f in fs])  # type: ignore[misc]
    n = sum(len(f) for f in fs)
    return Features(
        np.concatenate([xy for xy, *_ in parts]).astype(np.float32),
        np.concatenate([s for _, s, _ in parts]).astype(np.float32),
        np.zeros(n, np.float32),
        np.concatenate([f.scores for f in fs]),
        np.concatenate([f.descriptors for f in fs]),
        fs[0].norm,
        f"affine-{fs[0].operator}",
        (w, h),
        laplacian,
    )
