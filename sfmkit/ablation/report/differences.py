"""Paired differences between setups, with intervals and tests corrected for their number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr
from scipy.stats import rankdata

from .intervals import mean_interval
from .units import mean_per_unit

ALPHA = 0.05
_EXACT = 200  # units up to which the null distribution is enumerated


@dataclass(frozen=True)
class Difference:
    """The difference of two setups, the first minus the second.

    Attributes:
        first, second: setups.
        value, low, high: mean difference over the pairs with its 95 % interval; positive: the first
            is better.
        p: of Wilcoxon's signed-rank test, two-sided.
        p_holm: corrected for all differences of the family.
        better, worse: pairs on which the first is better, and worse.
    """

    first: int
    second: int
    value: float
    low: float
    high: float
    p: float
    p_holm: float
    better: int
    worse: int

    @property
    def real(self) -> bool:
        """Whether the test is significant and the interval excludes zero."""
        return self.p_holm < ALPHA and (self.low > 0 or self.high < 0)


def differences(
    quality: np.ndarray, asked: Sequence[tuple[int, int]], of_pair: np.ndarray | None = None
) -> list[Difference]:
    """Compute differences between setups, paired by pair and seed, as one family of tests.

    Seeds of one pair are not independent, and neither are pairs of one scene. Each unit, a scene or
    a pair, therefore counts once in the test, with the mean of its differences.

    Args:
        quality: (P, C) mean over the seeds, larger is better.
        asked: (first, second).
        of_pair: (P,) the unit of every pair, see :class:`~.units.Units`; None if every pair is one.
    """
    if not asked:
        return []
    d = np.stack([quality[:, i] - quality[:, j] for i, j in asked], axis=1)
    interval = mean_interval(d, of_pair)
    p = [signed_rank(column) for column in mean_per_unit(d, of_pair).T]
    return [
        Difference(
            i,
            j,
            *interval.at(k),
            p[k],
            corrected,
            int((d[:, k] > 0).sum()),
            int((d[:, k] < 0).sum()),
        )
        for k, ((i, j), corrected) in enumerate(zip(asked, holm(p)))
    ]


def signed_rank(d: np.ndarray) -> float:
    """Compute the two-sided p of Wilcoxon's signed-rank test, exact also with ties.

    Zero differences are left out.
    The null distribution, every sign as likely as the other, is enumerated by adding one rank after
    the other; beyond 200 differences the normal approximation is used. 1 where nothing differs.

    Source: Wilcoxon 1945; Hollander & Wolfe, Nonparametric Statistical Methods, 2nd edition,
    section 3.1.
    """
    d = d[d != 0]
    if not len(d):
        return 1.0
    ranks = rankdata(np.abs(d))
    w = ranks[d > 0].sum()
    if len(d) > _EXACT:
        z = (w - ranks.sum() / 2) / np.sqrt((ranks**2).sum() / 4)
        return float(2 * ndtr(-abs(z)))
    twice = np.rint(2 * ranks).astype(int)  # mid-ranks are halves
    chance = np.zeros(twice.sum() + 1)
    chance[0] = 1.0
    for r in twice:
        chance[r:] = (chance[r:] + chance[:-r]) / 2
        chance[:r] /= 2
    at = round(2 * w)
    return float(min(1.0, 2 * min(chance[: at + 1].sum(), chance[at:].sum())))


def least_p(units: int, tests: int = 1) -> float:
    """Return the smallest p that this many scenes or pairs can give, corrected for the tests."""
    return min(1.0, tests * 2.0 ** (1 - units))


def holm(p: Sequence[float]) -> list[float]:
    """Correct p-values for their number (Holm 1979).

    Rejecting those below α keeps the probability of any false rejection below α.
    """
    values = np.asarray(p, dtype=np.float64)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    corrected = np.empty_like(values)
    corrected[order] = np.minimum(stepped, 1)
    return corrected.tolist()
