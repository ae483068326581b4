"""How different two groups are, beyond whether they differ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import InputError


class Effect(NamedTuple):
    """Cliff's delta with its interval.

    Attributes:
        delta: P(a > b) - P(a < b) over all pairs of one of each group: 1 when all of the first are
            larger, 0 when neither tends to be. It equals the rank-biserial correlation. 0.15, 0.33
            and 0.47 are customarily called small, medium and large (Romano et al. 2006).
        low, high: bounds of its 95 % bootstrap interval.
        n: members of the first and the second group.
    """

    delta: float
    low: float
    high: float
    n: tuple[int, int]


def cliffs_delta(
    values: np.ndarray,
    first: np.ndarray,
    cells: np.ndarray | None = None,
    *,
    draws: int = 1000,
    seed: int = 0,
) -> Effect:
    """Cliff's delta between two groups (Cliff 1993), with a percentile bootstrap interval.

    Args:
        values: (N,) what is compared.
        first: (N,) bool: members of the first group; the others are the second.
        cells: (N,) int: units that are drawn as a whole, where neighbours are alike and a bootstrap
            of single values would make the interval too narrow. None: each value for itself.
        draws: bootstrap samples.
        seed: of the draws.

    Raises:
        InputError: a group is empty, or values are not finite.
    """
    values, first = np.asarray(values), np.asarray(first, dtype=bool)
    n = int(first.sum()), int((~first).sum())
    if not all(n):
        raise InputError(f"the two groups have {n[0]} and {n[1]} members; each needs at least one")
    if not np.isfinite(values).all():
        raise InputError("the values to compare hold NaN or infinite ones; leave those out first")
    _, rank = np.unique(values, return_inverse=True)
    _, cell = np.unique(np.arange(len(values)) if cells is None else cells, return_inverse=True)
    ranks = int(rank.max()) + 1

    def delta(weight: np.ndarray | None) -> float:
        a = np.bincount(rank[first], None if weight is None else weight[first], ranks)
        b = np.bincount(rank[~first], None if weight is None else weight[~first], ranks)
        if not (a.any() and b.any()):
            return np.nan
        below = np.cumsum(b) - b
        above = b.sum() - np.cumsum(b)
        return float(a @ (below - above) / (a.sum() * b.sum()))

    rng = np.random.default_rng(seed)
    count = int(cell.max()) + 1
    drawn = [
        delta(np.bincount(rng.integers(count, size=count), minlength=count)[cell])
        for _ in range(draws)
    ]
    low, high = (
        np.nanpercentile(drawn, (2.5, 97.5)) if np.isfinite(drawn).any() else (np.nan, np.nan)
    )
    return Effect(delta(None), float(low), float(high), n)
