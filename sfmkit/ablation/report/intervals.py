"""Bootstrap intervals over the independent units of a data set, see :mod:`~.units`.

Units are drawn with replacement. A unit is drawn with all of its pairs, and a pair with all of its
seeds, because runs with other seeds on the same pair are not new evidence about other pairs
(Davison & Hinkley, Bootstrap Methods and their Application, 1997, section 3.8, strategy 1). All
setups are computed on the same samples, so differences between them are paired.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

__all__ = ["DRAWS", "LEVEL", "Interval", "mean_interval", "median_interval", "share_best"]

DRAWS = 4000
LEVEL = 0.95


class Interval(NamedTuple):
    """Estimates and the bounds of their intervals, arrays of one shape.

    The bounds are NaN if there is only one unit.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def at(self, k: int) -> tuple[float, float, float]:
        """The estimate k with its bounds."""
        return float(self.value[k]), float(self.low[k]), float(self.high[k])


def _units(pairs: int, of_pair: np.ndarray | None) -> np.ndarray:
    return np.arange(pairs) if of_pair is None else of_pair


def _counts(n: int, draws: int, seed: int) -> np.ndarray:
    """(draws, n) how often each unit is in each bootstrap sample."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=draws)


def _sums(x: np.ndarray, of_pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(G, K) sums over the pairs of every unit, and (G,) numbers of pairs."""
    sizes = np.bincount(of_pair)
    sums = np.zeros((len(sizes), x.shape[1]))
    np.add.at(sums, of_pair, x)
    return sums, sizes.astype(np.float64)


def mean_interval(
    values: np.ndarray,
    of_pair: np.ndarray | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    level: float = LEVEL,
) -> Interval:
    """Compute means over the pairs with bias-corrected and accelerated (BCa) intervals.

    The mean of a sample is the sum over its pairs divided by their number, which varies if units
    have different numbers of pairs. The acceleration is that of the jackknife that leaves out one
    unit at a time.

    Args:
        values: (P, ...) one value per pair, the mean of its seeds.
        of_pair: (P,) the unit of every pair; None if every pair is a unit.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, equations 14.9, 14.10, 14.14
    and 14.15.
    """
    shape = values.shape[1:]
    x = values.reshape(len(values), -1)
    mean = x.mean(0)
    sums, sizes = _sums(x, _units(len(x), of_pair))
    n = len(sizes)
    if n == 1:
        return Interval(mean.reshape(shape), *np.full((2, *shape), np.nan))
    counts = _counts(n, draws, seed)
    replicates = np.sort(counts @ sums / (counts @ sizes)[:, None], axis=0)
    # Sums in another order do not count as a difference.
    off = 1e-12 * np.abs(x).max(initial=1e-300)
    below = (replicates < mean - off).mean(0) + (np.abs(replicates - mean) <= off).mean(0) / 2
    z0 = ndtri(np.clip(below, 1 / draws, 1 - 1 / draws))
    left_out = (sums.sum(0) - sums) / (sizes.sum() - sizes)[:, None]
    lever = left_out.mean(0) - left_out
    lever[np.abs(lever) <= off] = 0
    spread = (lever**2).sum(0) ** 1.5
    a = np.divide((lever**3).sum(0), 6 * spread, out=np.zeros_like(mean), where=spread > 0)
    bounds = []
    for tail in ((1 - level) / 2, (1 + level) / 2):
        z = z0 + ndtri(tail)
        bounds.append(_quantile(replicates, ndtr(z0 + z / (1 - a * z))).reshape(shape))
    return Interval(mean.reshape(shape), *bounds)


def _quantile(replicates: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The q-th quantile of each sorted column, each with its own q, by linear interpolation."""
    at = np.clip(q, 0, 1) * (len(replicates) - 1)
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(replicates) - 1)
    columns = np.arange(replicates.shape[1])
    return replicates[low, columns] + (at - low) * (
        replicates[high, columns] - replicates[low, columns]
    )


def median_interval(
    values: np.ndarray,
    of_pair: np.ndarray | None = None,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = LEVEL,
) -> Interval:
    """Compute medians over pairs and seeds with percentile intervals.

    The jackknife of BCa intervals fails for a median (ibid., section 11.6).

    Args:
        values: (P, C, S).
        of_pair: (P,) the unit of every pair; None if every pair is a unit.
    """
    value = np.median(values, axis=(0, 2))
    units = _units(len(values), of_pair)
    n = int(units.max()) + 1
    if n == 1:
        return Interval(value, *np.full((2, *value.shape), np.nan))
    samples = _counts(n, draws, seed)[:, units]
    replicates = np.stack(
        [np.median(np.repeat(values, counts, axis=0), axis=(0, 2)) for counts in samples]
    )
    low, high = np.quantile(replicates, ((1 - level) / 2, (1 + level) / 2), axis=0)
    return Interval(value, low, high)


def share_best(
    values: np.ndarray,
    of_pair: np.ndarray | None = None,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> np.ndarray:
    """Compute the share of the bootstrap samples in which each setup has the largest mean.

    Ties are shared.

    Args:
        values: (P, C), larger is better.
        of_pair: (P,) the unit of every pair; None if every pair is a unit.

    Returns:
        (C,).
    """
    sums, sizes = _sums(values, _units(len(values), of_pair))
    counts = _counts(len(sizes), draws, seed)
    means = counts @ sums / (counts @ sizes)[:, None]
    best = means >= means.max(axis=1, keepdims=True) - 1e-12
    return (best / best.sum(axis=1, keepdims=True)).mean(0)
