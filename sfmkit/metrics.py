"""Error measures for homographies, features and matches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from .errors import InputError
from .types import Features, Matches


def _homography(H: np.ndarray, name: str) -> np.ndarray:
    H = np.asarray(H, dtype=np.float64)
    if H.shape != (3, 3) or not np.isfinite(H).all() or H[2, 2] == 0:
        raise InputError(f"{name} must be a finite (3, 3) matrix with H[2, 2] != 0")
    return H


def _transfer(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    y = np.column_stack([x, np.ones(len(x))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(y[:, 2:] > 0, y[:, :2] / y[:, 2:], np.inf)


def homography_rmse(H: np.ndarray, H_true: np.ndarray) -> float:
    """Return the root mean square difference of the elements of two homographies.

    Both are scaled to ``H[2, 2] = 1``. This is the measure of Dippold & Tsai. It has no consistent
    unit: the elements are pure numbers, per pixel, or pixels, and the two translations in pixels
    dominate. (The paper states it in metres.)
    """
    A, B = _homography(H, "H"), _homography(H_true, "H_true")
    return float(np.sqrt(np.mean((A / A[2, 2] - B / B[2, 2]) ** 2)))


def corner_error(H: np.ndarray, H_true: np.ndarray, size_wh: tuple[int, int]) -> float:
    """Return the mean distance of the four corners of image 1 mapped by H and by the truth.

    The distance is in pixels of image 2. It is infinite if H maps a corner to infinity or behind
    the camera.

    Args:
        H, H_true: (3, 3) homographies, ``x2 = H x1``.
        size_wh: Width and height of image 1 in pixels.
    """
    w, h = size_wh
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], dtype=np.float64)
    A, B = (M / M[2, 2] for M in (_homography(H, "H"), _homography(H_true, "H_true")))
    a, b = _transfer(A, corners), _transfer(B, corners)
    if not np.isfinite(a).all():
        return float("inf")
    return float(np.linalg.norm(a - b, axis=1).mean())


def check_point_error(H: np.ndarray, points: np.ndarray) -> float:
    """Return the mean distance of annotated points of image 2 from their partners mapped by H.

    Args:
        H: (3, 3) homography, ``x2 = H x1``.
        points: (N, 4) rows of x1, y1, x2, y2 in pixels.

    Returns:
        The distance in pixels of image 2; infinite if H maps a point to infinity or behind the
        camera.

    Raises:
        InputError: H is not a finite matrix with ``H[2, 2] != 0``, or there are no points.
    """
    P = np.asarray(points, dtype=np.float64)
    if P.ndim != 2 or P.shape[1] != 4 or not len(P) or not np.isfinite(P).all():
        raise InputError(f"points must be finite numbers of shape (N, 4), not {P.shape}")
    A = _homography(H, "H")
    y = _transfer(A / A[2, 2], P[:, :2])
    if not np.isfinite(y).all():
        return float("inf")
    return float(np.linalg.norm(y - P[:, 2:], axis=1).mean())


def error_auc(
    errors: Sequence[float], thresholds: Sequence[float] = (1.0, 3.0, 5.0)
) -> list[float]:
    """Return the area under the recall curve up to each threshold, divided by the threshold.

    The curve is the step function "share of pairs with an error of at most e".

    Args:
        errors: One error per pair; infinity for a pair without an estimate.
        thresholds: Positive thresholds in the unit of the errors.

    Returns:
        One area per threshold, in [0, 1].

    Raises:
        InputError: There are no errors, or one is NaN.
    """
    e = np.asarray(errors, dtype=np.float64)
    if not len(e) or np.isnan(e).any():
        raise InputError(
            "errors must be at least one number; infinity for a pair without an estimate"
        )
    return [float(np.clip(1 - e / t, 0, None).mean()) for t in thresholds]


def trapezoidal_auc(errors: Sequence[float], thresholds: Sequence[float]) -> list[float]:
    """Return the area under the piecewise linear recall curve up to each threshold.

    The curve joins (0, 0) and the points (error of the k-th best pair, k / N), and is constant
    after the last error below the threshold. The area is larger than that of :func:`error_auc`.

    Args:
        errors: One error per pair; infinity for a pair without an estimate.
        thresholds: Positive thresholds in the unit of the errors.

    Returns:
        The area from 0 to each threshold, divided by the threshold, in [0, 1].

    Raises:
        InputError: There are no errors, one is NaN or negative, or a threshold is not positive.

    Source: the evaluation of Sarlin, DeTone, Malisiewicz & Rabinovich, SuperGlue, CVPR 2020.
    """
    e = np.sort(np.asarray(errors, dtype=np.float64))
    if not len(e) or not (e >= 0).all():
        raise InputError("errors must be at least one number >= 0; infinity for a failed pair")
    if not all(t > 0 for t in thresholds):
        raise InputError(f"thresholds must be positive, not {list(thresholds)}")
    areas = []
    for t in thresholds:
        below = e[e < t]
        recall = np.arange(len(below) + 1) / len(e)
        x, y = np.array([0.0, *below, t]), np.append(recall, recall[-1])
        areas.append(float(np.trapezoid(y, x) / t))
    return areas


def repeatability(
    features1: Features, features2: Features, H_true: np.ndarray, radius_px: float = 3.0
) -> tuple[float, int]:
    """Return the repeatability of the keypoints in the common part of two images.

    Keypoints form a pair if they are mutual nearest neighbours in image 2 and at most `radius_px`
    apart. Their sizes and shapes are ignored.

    Args:
        features1, features2: Features of both images.
        H_true: (3, 3) true homography, ``x2 = H x1``.
        radius_px: Largest distance of a pair, pixels of image 2.

    Returns:
        The number of pairs divided by the smaller number of keypoints in the common part, and the
        number of pairs.

    Source: Mikolajczyk et al., IJCV 2005, section 5, with points in place of ellipses.
    """
    H = _homography(H_true, "H_true")
    a = _transfer(H / H[2, 2], features1.keypoints)
    inside1 = _inside(a, features2.size_wh)
    b = features2.keypoints.astype(np.float64)
    Hi = np.linalg.inv(H)
    inside2 = _inside(_transfer(Hi / Hi[2, 2], b), features1.size_wh)
    a, b = a[inside1], b[inside2]
    if not len(a) or not len(b):
        return 0.0, 0
    near, j = cKDTree(b).query(a, distance_upper_bound=radius_px)
    found = np.isfinite(near)
    _, i = cKDTree(a).query(b[j[found]])
    n = int((i == np.flatnonzero(found)).sum())
    return n / min(len(a), len(b)), n


def _inside(x: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    return np.all((x >= 0) & (x <= np.array(size_wh) - 1), axis=1)


def match_errors(
    features1: Features, features2: Features, matches: Matches, H_true: np.ndarray
) -> np.ndarray:
    """Return the distance of each match from its true position, (M,) pixels of image 2."""
    x1, x2 = features1.keypoints[matches.index1], features2.keypoints[matches.index2]
    return transfer_errors(x1, x2, H_true)


def transfer_errors(x1: np.ndarray, x2: np.ndarray, H_true: np.ndarray) -> np.ndarray:
    """Return the distance of each pixel `x2` from the true position of `x1`, (M,) pixels.

    Args:
        x1, x2: (M, 2) corresponding pixels of image 1 and image 2.
        H_true: (3, 3) true homography, ``x2 = H x1``.
    """
    H = _homography(H_true, "H_true")
    return np.linalg.norm(_transfer(H / H[2, 2], x1) - x2, axis=1)


def mean_matching_accuracy(
    errors: np.ndarray, thresholds: Sequence[float] = tuple(range(1, 11))
) -> list[float]:
    """Return the share of the matches within each threshold in pixels; zeros without matches.

    Source: Dusmanu et al., D2-Net, CVPR 2019, section 5.1 (which then averages over the pairs).
    """
    e = np.asarray(errors, dtype=np.float64)
    return [float((e <= t).mean()) if len(e) else 0.0 for t in thresholds]


def matching_score(
    features1: Features,
    features2: Features,
    matches: Matches,
    H_true: np.ndarray,
    radius_px: float = 3.0,
) -> float:
    """Return the number of correct matches divided by the smaller number of keypoints.

    Only keypoints in the common part of both images are counted.

    Source: Mikolajczyk et al., IJCV 2005, section 5.
    """
    H = _homography(H_true, "H_true")
    Hi = np.linalg.inv(H)
    n1 = int(_inside(_transfer(H / H[2, 2], features1.keypoints), features2.size_wh).sum())
    n2 = int(_inside(_transfer(Hi / Hi[2, 2], features2.keypoints), features1.size_wh).sum())
    right = int((match_errors(features1, features2, matches, H_true) <= radius_px).sum())
    return right / min(n1, n2) if min(n1, n2) else 0.0
