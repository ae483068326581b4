"""Homography-guided matching.

The search for nearest neighbours over the whole image fails where details repeat or an operator is
weak. If the homography is roughly known, a feature has a few candidates instead of thousands, and
the same descriptors give several times as many correct matches.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from ..types import Features, Matches
from .nearest import _check_comparable, _hamming_distance, _l2_distance

_CANDIDATES = 8  # number of nearest features that are compared
_CHUNK = 1 << 16  # number of candidates that are compared at a time


def match_guided(
    features1: Features,
    features2: Features,
    H: np.ndarray,
    *,
    radius_px: float = 6.0,
    max_distance: float = np.inf,
    max_octaves: float = 0.4,
) -> Matches:
    """Match mutual nearest neighbours among pairs that agree with a homography.

    The pairs agree with H in position and in size.

    Args:
        features1, features2: Features of one operator in image 1 and image 2.
        H: (3, 3) homography, ``x2 = H x1`` in pixels.
        radius_px: Largest distance from the predicted position, pixels of image 2.
        max_distance: Largest descriptor distance.
        max_octaves: Largest difference in octaves between the size of a feature in image 2 and the
            size that H predicts; ignored if the operator gives all features the same size.

    Returns:
        M matches in the order of ``index1``; ``ratio`` is NaN, because there is often only one
        candidate.

    Raises:
        InputError: The features cannot be compared, H is singular, or a radius is not positive.
    """
    _check_comparable(features1, features2)
    H = np.asarray(H, dtype=np.float64)
    if H.shape != (3, 3) or not np.isfinite(H).all() or np.linalg.det(H) == 0:
        raise InputError("H must be a regular (3, 3) matrix of finite numbers")
    if not radius_px > 0 or not max_octaves > 0:
        raise InputError("radius_px and max_octaves must be positive")
    none = np.zeros(0, np.int64)
    if not len(features1) or not len(features2):
        return Matches(none, none, np.zeros(0, np.float32), np.zeros(0, np.float32))

    predicted, growth = _predict(H, features1.keypoints.astype(np.float64))
    ahead = np.flatnonzero(np.isfinite(growth))
    k = min(_CANDIDATES, len(features2))
    near, rows = cKDTree(features2.keypoints).query(
        predicted[ahead], k=np.arange(1, k + 1), distance_upper_bound=radius_px
    )
    at, nth = np.nonzero(np.isfinite(near))
    i, j = ahead[at], rows[at, nth]

    fits = np.ones(len(i), dtype=bool)
    if features1.laplacian is not None and features2.laplacian is not None:
        fits &= features1.laplacian[i] == features2.laplacian[j]
    if np.ptp(features1.scales) > 0:
        with np.errstate(divide="ignore", invalid="ignore"):
            fits &= (
                np.abs(np.log2(features2.scales[j] / (features1.scales[i] * growth[i])))
                <= max_octaves
            )
    i, j = i[fits], j[fits]

    measure = _l2_distance if features1.norm == "l2" else _hamming_distance
    parts = range(0, len(i), _CHUNK)
    a, b = features1.descriptors, features2.descriptors
    distance = np.concatenate(
        [
            np.zeros(0, np.float32),
            *(measure(a[i[s : s + _CHUNK]], b[j[s : s + _CHUNK]]) for s in parts),
        ]
    )
    keep = np.flatnonzero(distance <= max_distance)
    keep = keep[
        np.lexsort((j[keep], i[keep], distance[keep]))
    ]  # nearest first; of equals the lowest rows
    i, j, distance = i[keep], j[keep], distance[keep]
    mutual = np.zeros(len(i), dtype=bool)
    mutual[np.unique(i, return_index=True)[1]] = True
    first = np.zeros_like(mutual)
    first[np.unique(j, return_index=True)[1]] = True
    mutual &= first
    i, j, distance = i[mutual], j[mutual], distance[mutual]
    order = np.argsort(i)
    ratio = np.full(len(i), np.nan, np.float32)
    return Matches(i[order], j[order], distance[order], ratio)


def _predict(H: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``H x`` (N, 2) and the magnification of H at x (N,), NaN behind the camera."""
    y = np.column_stack([x, np.ones(len(x))]) @ H.T
    depth = y[:, 2]
    ahead = depth * np.sign(np.median(depth)) > 0
    growth = np.full(len(x), np.nan)
    growth[ahead] = np.sqrt(np.abs(np.linalg.det(H)) / np.abs(depth[ahead]) ** 3)
    return y[:, :2] / np.where(ahead, depth, 1.0)[:, None], growth
