"""A keypoint budget that keeps the whole image covered."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError


def suppression_radii(keypoints: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Distance from every keypoint to the nearest stronger one; infinite for the strongest.

    Of equally strong ones the earlier row counts as stronger. (Brown, Szeliski & Winder 2005, eq. 5, with c = 1.)

    Args:
        keypoints: (N, 2) pixels.
        scores: (N,) strengths.

    Returns:
        (N,) float64 pixels.
    """
    order = np.argsort(-scores, kind="stable")
    points = keypoints[order]
    radii = np.full(len(points), np.inf)
    # From weak to strong, the weaker half of what is left among all of it: a stronger neighbour is then close in rank,
    # and a keypoint without one among its nearest few is rare and looks further.
    end = len(points)
    while end > 1:
        tree = cKDTree(points[:end])
        pending, k = np.arange(end // 2, end), 4
        while len(pending):
            k = min(k, end)
            distance, neighbour = tree.query(points[pending], k=k)
            stronger = neighbour < pending[:, None]
            found = stronger.any(axis=1)
            radii[pending[found]] = distance[found, stronger[found].argmax(axis=1)]
            pending, k = pending[~found], 4 * k
        end //= 2
    radii[order] = radii.copy()
    return radii


def select_evenly(keypoints: np.ndarray, scores: np.ndarray, budget: int, size_wh: tuple[int, int]) -> np.ndarray:
    """At most `budget` keypoints, strong ones, spread over the image: adaptive non-maximal suppression.

    Kept are those that dominate the largest neighbourhoods: the `budget` largest distances to the nearest stronger
    keypoint (Brown, Szeliski & Winder 2005, section 3).

    Args:
        keypoints: (N, 2) pixels.
        scores: (N,) larger is stronger.
        budget: how many to keep, at least 1.
        size_wh: the image's width and height; keypoints must lie in it.

    Returns:
        Rows of the chosen keypoints, ascending. The same input gives the same rows.

    Raises:
        InputError: a budget below 1, shapes that do not fit, or keypoints outside the image.
    """
    if isinstance(budget, bool) or not isinstance(budget, (int, np.integer)) or budget < 1:
        raise InputError(f"the keypoint budget must be a whole number of at least 1, not {budget!r}")
    keypoints, scores = np.asarray(keypoints, dtype=np.float64), np.asarray(scores, dtype=np.float64)
    if keypoints.ndim != 2 or keypoints.shape[1] != 2 or scores.shape != keypoints.shape[:1]:
        raise InputError(f"keypoints (N, 2) and scores (N,) expected, not {keypoints.shape} and {scores.shape}")
    if not (np.isfinite(keypoints).all() and np.isfinite(scores).all()):
        raise InputError("keypoints and scores must be finite")
    if len(keypoints) and ((keypoints < -1).any() or (keypoints > size_wh).any()):
        raise InputError(f"keypoints lie outside the {size_wh[0]} x {size_wh[1]} image")
    if len(keypoints) <= budget:
        return np.arange(len(keypoints))
    radii = suppression_radii(keypoints, scores)
    order = np.lexsort((np.arange(len(radii)), -scores, -radii))
    return np.sort(order[:budget])
