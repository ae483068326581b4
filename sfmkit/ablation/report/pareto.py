"""Which setups are worth their time."""

from __future__ import annotations

import numpy as np


def pareto_front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """(C,) bool: setups that no other one beats, being no worse in both and better in one.

    Args:
        cost, error: (C,), smaller is better; NaN is on no front.
    """
    known = np.isfinite(cost) & np.isfinite(error)
    no_worse = (cost[:, None] <= cost) & (error[:, None] <= error)
    better = (cost[:, None] < cost) | (error[:, None] < error)
    beaten = (no_worse & better & known[:, None]).any(axis=0)
    return known & ~beaten
