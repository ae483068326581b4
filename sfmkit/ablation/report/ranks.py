"""Setups ranked over scenes or pairs: Friedman's test and Nemenyi's critical difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, rankdata, studentized_range

from ...errors import InputError
from .differences import ALPHA


@dataclass(frozen=True, eq=False)
class Ranking:
    """Average ranks; 1 is the best.

    Attributes:
        average: (C,) in the order of the setups.
        order: (C,) setups, best first.
        statistic, p: Friedman's, of the hypothesis that all setups are equal.
        critical_difference: smaller differences of average ranks are not significant.
        groups: (first, last) places in `order` of the largest groups of setups without significant
            differences.
        blocks: number of scenes or pairs on which the setups were ranked.
        unit: ``scene``, ``pair`` or both.
    """

    average: np.ndarray
    order: np.ndarray
    statistic: float
    p: float
    critical_difference: float
    groups: tuple[tuple[int, int], ...]
    blocks: int
    unit: str = "pair"


def rank(quality: np.ndarray, alpha: float = ALPHA, *, unit: str = "pair") -> Ranking:
    """Rank setups on every scene or pair and compare the average ranks.

    Args:
        quality: (G, C) larger is better; ties share their ranks.
        unit: what a row of `quality` is.

    Source: Demsar, JMLR 7 (2006), section 3.2.2; Friedman's statistic with the correction for ties
    of Hollander & Wolfe (equation 7.8).

    Raises:
        InputError: fewer than two setups.
    """
    n, k = quality.shape
    if k < 2:
        raise InputError("a ranking needs at least two setups")
    ranks = rankdata(-np.round(quality, 12), axis=1)
    average = ranks.mean(0)
    spread = (ranks**2).sum() - n * k * (k + 1) ** 2 / 4  # n k (k + 1) (k - 1) / 12 without ties
    statistic = (
        float((k - 1) * n**2 * ((average - (k + 1) / 2) ** 2).sum() / spread)
        if spread > 1e-9
        else 0.0
    )
    cd = float(
        studentized_range.ppf(1 - alpha, k, np.inf) / np.sqrt(2) * np.sqrt(k * (k + 1) / (6 * n))
    )
    order = np.argsort(average, kind="stable")
    return Ranking(
        average,
        order,
        statistic,
        float(chi2.sf(statistic, k - 1)),
        cd,
        _groups(average[order], cd),
        n,
        unit,
    )


def _groups(ordered: np.ndarray, cd: float) -> tuple[tuple[int, int], ...]:
    """The maximal runs of sorted average ranks that span less than `cd`."""
    runs: list[tuple[int, int]] = []
    for first, lowest in enumerate(ordered):
        last = int(np.flatnonzero(ordered - lowest < cd)[-1])
        if last > first and (not runs or last > runs[-1][1]):
            runs.append((first, last))
    return tuple(runs)
