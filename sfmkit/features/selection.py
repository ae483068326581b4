"""Selection of a limited number of keypoints, spread over the whole image."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError

ROBUSTNESS = 0.5  # a keypoint is suppressed by one twice as strong; see docs/benchmarks.md
_LEAF_BITS = 6


def suppression_radii(
    keypoints: np.ndarray, scores: np.ndarray, robustness: float = ROBUSTNESS
) -> np.ndarray:
    """Compute the distance from every keypoint to the nearest clearly stronger keypoint.

    Keypoint j is clearly stronger than i if ``score_i < robustness * score_j`` (Brown, Szeliski &
    Winder 2005, section 3). With a robustness of 1, the first of two equal keypoints is regarded as
    stronger.

    Args:
        keypoints: (N, 2) pixels.
        scores: (N,) strengths, not negative.
        robustness: At most 1. A smaller value reduces the influence of noise in the scores.

    Returns:
        (N,) float64 pixels; infinite without a clearly stronger keypoint.
    """
    order = np.argsort(-scores, kind="stable")
    points, strength = keypoints[order], scores[order]
    # In order of strength, the first stronger[i] points are clearly stronger than point i.
    n = len(points)
    stronger = (
        np.arange(n) if robustness == 1 else np.searchsorted(-robustness * strength, -strength)
    )
    radii = np.empty(n)
    radii[order] = _distance_to_first(points, stronger)
    return radii


def _distance_to_first(points: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Compute the distance from point i to the nearest of ``points[:first[i]]``, or infinity.

    The first m points consist of one block of 2^b points for every bit b that is set in m. Each
    block has its own k-d tree, and the last few points are compared one by one.
    """
    distance = np.full(len(points), np.inf)
    for bit in range(_LEAF_BITS, int(first.max(initial=0)).bit_length()):
        with_block = np.flatnonzero(first >> bit & 1)
        start = first[with_block] >> (bit + 1) << (bit + 1)
        order = np.argsort(start, kind="stable")
        for queries in np.split(with_block[order], np.flatnonzero(np.diff(start[order])) + 1):
            if len(queries):
                at = first[queries[0]] >> (bit + 1) << (bit + 1)
                tree = cKDTree(
                    points[at : at + (1 << bit)], balanced_tree=False, compact_nodes=False
                )
                distance[queries] = np.minimum(distance[queries], tree.query(points[queries])[0])
    tail = first & ((1 << _LEAF_BITS) - 1)
    for k in range(1, 1 << _LEAF_BITS):
        queries = np.flatnonzero(tail >= k)
        distance[queries] = np.minimum(
            distance[queries], np.hypot(*(points[queries] - points[first[queries] - k]).T)
        )
    return distance


def select_evenly(
    keypoints: np.ndarray, scores: np.ndarray, budget: int, size_wh: tuple[int, int]
) -> np.ndarray:
    """Select at most `budget` strong keypoints, spread over the image.

    Adaptive non-maximal suppression (Brown, Szeliski & Winder 2005, section 3) keeps the keypoints
    with the `budget` largest distances to the nearest clearly stronger keypoint. If more than
    `budget` keypoints have no clearly stronger one, those with the largest distances to any
    stronger keypoint are kept.

    Args:
        keypoints: (N, 2) pixels inside the image.
        scores: (N,) strengths.
        budget: Number of keypoints to keep, at least 1.
        size_wh: Width and height of the image in pixels.

    Returns:
        Rows of the selected keypoints in ascending order. The same input gives the same rows.

    Raises:
        InputError: The budget is below 1, shapes do not fit, or keypoints lie outside the image.
    """
    if isinstance(budget, bool) or not isinstance(budget, (int, np.integer)) or budget < 1:
        raise InputError(
            f"the keypoint budget must be a whole number of at least 1, not {budget!r}"
        )
    keypoints, scores = (
        np.asarray(keypoints, dtype=np.float64),
        np.asarray(scores, dtype=np.float64),
    )
    if keypoints.ndim != 2 or keypoints.shape[1] != 2 or scores.shape != keypoints.shape[:1]:
        raise InputError(
            f"keypoints (N, 2) and scores (N,) expected, not {keypoints.shape} and {scores.shape}"
        )
    if not (np.isfinite(keypoints).all() and np.isfinite(scores).all()):
        raise InputError("keypoints and scores must be finite")
    if len(keypoints) and ((keypoints < -1).any() or (keypoints > size_wh).any()):
        raise InputError(f"keypoints lie outside the {size_wh[0]} x {size_wh[1]} image")
    if len(keypoints) <= budget:
        return np.arange(len(keypoints))
    scores = scores - min(0.0, scores.min())
    radii = suppression_radii(keypoints, scores)
    ruled_by_none = np.flatnonzero(np.isinf(radii))
    if len(ruled_by_none) > budget:
        radii = suppression_radii(keypoints[ruled_by_none], scores[ruled_by_none], robustness=1)
        return ruled_by_none[np.sort(np.lexsort((-scores[ruled_by_none], -radii))[:budget])]
    return np.sort(np.lexsort((-scores, -radii))[:budget])
