"""Evenly spread samples of points in an image."""

from __future__ import annotations

from typing import Any

import numpy as np


def spread(x: np.ndarray, n: int) -> np.ndarray:
    """Choose rows of at most n points of (N, 2) that are spread evenly over the image.

    The points are assigned to the cells of a grid. The first point of every cell is chosen before
    any second one. If the points are sorted by strength, the strongest of every cell is chosen.
    """
    if len(x) <= n:
        return np.arange(len(x))
    cells = max(2, round(np.sqrt(n)))
    low, high = x.min(0), x.max(0)
    cell = np.minimum(((x - low) / np.maximum(high - low, 1e-9) * cells).astype(int), cells - 1)
    key = cell[:, 0] * cells + cell[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.concatenate(([True], np.diff(key[order]) > 0))
    rank = np.arange(len(x)) - np.maximum.accumulate(np.where(starts, np.arange(len(x)), 0))
    return order[np.argsort(rank, kind="stable")][:n]


def spread_strongest(x: np.ndarray, scores: Any, n: int) -> np.ndarray:
    """Choose rows of n strong, evenly spread keypoints (N, 2); without scores, the first ones."""
    order = np.arange(len(x)) if scores is None else np.argsort(-np.asarray(scores), kind="stable")
    return order[spread(x[order], n)]
