"""Operators on simulated oblique views.

Most operators are robust to changes of scale and rotation, but hardly any to a surface seen from
the side. The operator therefore also runs on images that are tilted as an oblique camera would see
them. If this is done for both images and all features are used together, views that are up to 80
degrees apart can be matched.

Source: Morel & Yu, "ASIFT: a new framework for fully affine invariant image comparison", SIAM J.
Imaging Sciences 2009.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from .._utils.registry import accepted
from ..errors import InputError
from ..types import Features
from .bounds import TILTS

AFFINE = "affine-"  # prefix of the name of the operator

# The blur against aliasing, before an axis is compressed t times, is this times sqrt(t² - 1), as in
# the paper.
_PREFILTER = 0.8
# in radii of a keypoint; the neighbourhood of a nearer keypoint contains the edge of the image
_MARGIN = 1.5


def views(tilts: int) -> Iterator[tuple[float, float]]:
    """Yield the tilt t and the rotation phi (radians) of each simulated view.

    The tilts are ``t = sqrt(2)^k``; phi has steps of 72°/t from 0 to 180 degrees.
    """
    yield 1.0, 0.0
    for k in range(1, tilts + 1):
        t = math.sqrt(2) ** k
        for step in range(math.ceil(180 * t / 72 - 1e-9)):
            yield t, math.radians(step * 72 / t)


def tilted(image: np.ndarray, t: float, phi: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate the view with tilt `t` in the direction `phi`.

    Returns:
        The view (h, w, 3) or (h, w) uint8, the (2, 3) affine map from `image` to the view, and a
        mask (h, w) that is 0 outside `image`.
    """
    h, w = image.shape[:2]
    c, s = math.cos(phi), math.sin(phi)
    R = np.array([[c, -s], [s, c]])
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]]) @ R.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    turn = np.column_stack([R, -low])
    turned = cv2.warpAffine(
        image, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    inside = cv2.warpAffine(np.full((h, w), 255, np.uint8), turn, size, flags=cv2.INTER_NEAREST)
    if t == 1.0:
        return turned, turn, inside
    turned = cv2.GaussianBlur(turned, (0, 0), sigmaX=_PREFILTER * math.sqrt(t * t - 1), sigmaY=0.01)
    squeeze = np.array([[1 / t, 0, 0], [0, 1, 0.0]])
    small = (max(1, int(size[0] / t)), size[1])
    view = cv2.warpAffine(
        turned, squeeze, small, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    mask = cv2.warpAffine(inside, squeeze, small, flags=cv2.INTER_NEAREST)
    return view, np.diag([1 / t, 1.0]) @ turn, mask


@dataclass(frozen=True)
class AffineOperator:
    """An operator that is applied to an image and to simulated oblique views of it.

    Attributes:
        base: The operator; see :class:`sfmkit.features.plugins.Operator`.
    """

    base: Callable[..., Features]

    @property
    def options(self) -> Mapping[str, Any]:
        """Every option with its default: those of the base operator, and ``tilts``."""
        return {**getattr(self.base, "options", {}), "tilts": 2}

    def __call__(
        self,
        image: np.ndarray,
        *,
        tilts: int = 2,
        preset: str = "default",
        device: Any = None,
        **options: Any,
    ) -> Features:
        """Find and describe features in an image and in its simulated views.

        Args:
            image: (H, W, 3) or (H, W) uint8.
            tilts: Number of steps of sqrt(2) in tilt. Two steps (up to a tilt of 2, a view 60
                degrees from the normal) need 10 views, three need 18.
            preset, device: Passed to base operators with such parameters.
            options: Options of the base operator.

        Returns:
            The features of all views in pixels of the image. Scales are those in the image (root of
            the area). Angles are 0, because they have no meaning after a tilt.

        Raises:
            InputError: The number of tilts is out of range, or the base operator raises it.
        """
        low, high = TILTS
        whole = isinstance(tilts, (int, np.integer)) and not isinstance(tilts, bool)
        if not whole or not low <= tilts <= high:
            raise InputError(f"'tilts' must be a whole number from {low} to {high}, not {tilts!r}")
        common = accepted(self.base, {"preset": preset, "device": device}, rest=False)
        h, w = image.shape[:2]
        parts = []
        for t, phi in views(tilts):
            view, A, mask = tilted(image, t, phi)
            f = self.base(view, **common, **options)
            f = f.take(_inside(f, mask))
            xy = (f.keypoints - A[:, 2]) @ np.linalg.inv(A[:, :2]).T
            parts.append(
                replace(
                    f,
                    keypoints=xy.clip(0, (w - 1, h - 1)).astype(np.float32),
                    scales=(f.scales * math.sqrt(t)).astype(np.float32),
                    angles=np.zeros(len(f), np.float32),
                    size_wh=(w, h),
                )
            )
        return _joined(parts)


def _inside(f: Features, mask: np.ndarray) -> np.ndarray:
    """Return the rows of the features whose neighbourhoods lie inside the mask."""
    padded = np.pad((mask > 0).astype(np.uint8), 1)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
    size = mask.shape[1] - 1, mask.shape[0] - 1
    at = np.rint(f.keypoints).astype(np.int64).clip(0, size)
    return np.flatnonzero(distance[at[:, 1], at[:, 0]] > _MARGIN * f.scales / 2)


def _joined(parts: list[Features]) -> Features:
    names = ["keypoints", "scales", "angles", "scores", "descriptors"]
    if parts[0].laplacian is not None:
        names.append("laplacian")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(f, name) for f in parts]) for name in names
    }
    return replace(parts[0], **columns)
