"""Bootstrap intervals over pairs.

Pairs are drawn, with replacement, and each brings all its seeds along: runs with other seeds on the
same pair are not new evidence about other pairs (Davison & Hinkley, Bootstrap Methods and their
Application, 1997, section 3.8, strategy 1). All setups are computed on the same draws, so
differences between them are paired.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

DRAWS = 4000
LEVEL = 0.95


class Interval(NamedTuple):
    """Estimates with the bounds of their intervals, arrays of one shape. Bounds are NaN where there
    is but one pair."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def at(self, k: int) -> tuple[float, float, float]:
        return float(self.value[k]), float(self.low[k]), float(self.high[k])


def _counts(n: int, draws: int, seed: int) -> np.ndarray:
    """(draws, n) how often each pair is in each bootstrap sample."""
    return np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=draws)


def mean_interval(
    values: np.ndarray, *, draws: int = DRAWS, seed: int = 0, level: float = LEVEL
) -> Interval:
    """Means over the pairs with bias-corrected and accelerated (BCa) intervals.

    Args:
        values: (P, ...) one value per pair, the mean of its seeds.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, equations 14.9, 14.10, 14.14
    and 14.15; for a mean the jackknife of the last has a closed form.
    """
    n, shape = len(values), values.shape[1:]
    x = values.reshape(n, -1)
    mean = x.mean(0)
    if n == 1:
        return Interval(mean.reshape(shape), *np.full((2, *shape), np.nan))
    replicates = np.sort(_counts(n, draws, seed) @ x / n, axis=0)
    off = 1e-12 * np.abs(x).max(
        initial=1e-300
    )  # sums in another order do not count as a difference
    below = (replicates < mean - off).mean(0) + (np.abs(replicates - mean) <= off).mean(0) / 2
    z0 = ndtri(np.clip(below, 1 / draws, 1 - 1 / draws))
    centred = x - mean
    spread = (centred**2).sum(0) ** 1.5
    a = np.divide((centred**3).sum(0), 6 * spread, out=np.zeros_like(mean), where=spread > 0)
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
    values: np.ndarray, *, draws: int = 1000, seed: int = 0, level: float = LEVEL
) -> Interval:
    """Medians over pairs and seeds with percentile intervals (BCa's jackknife fails for a median:
    ibid., section 11.6).

    Args:
        values: (P, C, S).
    """
    value = np.median(values, axis=(0, 2))
    if len(values) == 1:
        return Interval(value, *np.full((2, *value.shape), np.nan))
    samples = _counts(len(values), draws, seed)
    replicates = np.stack(
        [np.median(np.repeat(values, counts, axis=0), axis=(0, 2)) for counts in samples]
    )
    low, high = np.quantile(replicates, ((1 - level) / 2, (1 + level) / 2), axis=0)
    return Interval(value, low, high)


def share_best(values: np.ndarray, *, draws: int = DRAWS, seed: int = 0) -> np.ndarray:
    """(C,) in which share of the bootstrap samples each setup has the largest mean; ties are
    shared.

    Args:
        values: (P, C), larger is better.
    """
    means = _counts(len(values), draws, seed) @ values / len(values)
    best = means >= means.max(axis=1, keepdims=True) - 1e-12
    return (best / best.sum(axis=1, keepdims=True)).mean(0)
