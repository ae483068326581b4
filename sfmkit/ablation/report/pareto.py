"""The Pareto front of time and error."""

from __future__ import annotations

import numpy as np


def pareto_front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Find the setups that no other dominates: (C,) bool.

    A setup dominates another if it is not worse in both values and better in one.

    Args:
        cost, error: (C,), smaller is better; a setup with NaN is not on the front.
    """
    known = np.isfinite(cost) & np.isfinite(error)
    no_worse = (cost[:, None] <= cost) & (error[:, None] <= error)
    better = (cost[:, None] < cost) | (error[:, None] < error)
    beaten = (no_worse & better & known[:, None]).any(axis=0)
    return known & ~beaten
