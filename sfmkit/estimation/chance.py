"""How many matches agree with a model by chance (a contrario).

Source: Moisan & Stival, "A probabilistic criterion to detect rigid point matches between two images
and estimate the fundamental matrix", IJCV 2004.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from scipy.stats import binom
from torch import Tensor

__all__ = ["MAX_LOG10_NFA", "chance_agreement", "log10_nfa", "log10_tail"]

MAX_LOG10_NFA = -6.0  # fewer than one model in a million by chance alone
_CHANCE_TRIALS = 20_000  # wrong matches that the probability of chance agreement is measured on


def log10_nfa(inliers: int, matches: int, chance: float, sample: int, solutions: int) -> float:
    """Compute log10 of the number of models with this many inliers to expect by chance.

    Args:
        chance: probability that a random match agrees with the model.
        sample, solutions: size of a minimal sample and the number of models it gives.
    """
    if inliers <= sample:
        return math.inf

    def log_choose(n: int, k: int) -> float:
        return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)

    return (
        math.log(solutions * (matches - sample))
        + log_choose(matches, inliers)
        + log_choose(inliers, sample)
        + (inliers - sample) * math.log(min(max(chance, 1e-12), 1.0))
    ) / math.log(10)


def chance_agreement(
    squared: Callable[[Tensor, Tensor], Tensor],
    x1: Tensor,
    x2: Tensor,
    threshold_px: float,
    generator: torch.Generator,
    trials: int = _CHANCE_TRIALS,
) -> float:
    """Measure the probability that a wrong match agrees with a model.

    Every point gets the partner of another match, by cyclic shifts of the matches in random order:
    a random permutation would leave one match with its own partner on average, which makes the
    probability too large by 1/N. Keypoints cluster, so the probability is larger than the share of
    the image that the epipolar band covers.

    Args:
        squared: (N, 2), (N, 2) -> (N,) squared residuals of the model, square pixels.
        x1, x2: (N, 2) pixels, N at least 2.
        threshold_px: Largest residual of an inlier, pixels.
        generator: Of the order and the shifts.
        trials: Wrong matches to try, about; all N (N - 1) of them where there are fewer.
    """
    n = len(x1)
    rounds = min(max(1, trials // n), max(1, n - 1))
    order = torch.randperm(n, generator=generator)
    shifts = torch.randperm(max(1, n - 1), generator=generator)[:rounds] + 1
    partner = order[(torch.arange(n) + shifts[:, None]) % n].to(x1.device)
    point = order.to(x1.device).expand(rounds, n)
    hits = int((squared(x1[point.flatten()], x2[partner.flatten()]) < threshold_px**2).sum())
    return (hits + 1) / (rounds * n + 1)


def log10_tail(k: int, n: int, p: float) -> float:
    """Compute log10 of the probability of at least k successes in n trials of probability p.

    Where it is too small for floating point, Chernoff's bound exp(-n KL(k/n, p)).
    """
    tail = float(binom.logsf(k - 1, n, p))
    if math.isinf(tail) and k > n * p > 0:
        q = k / n
        rest = 0.0 if q == 1 else (1 - q) * math.log((1 - q) / (1 - p))
        tail = -n * (q * math.log(q / p) + rest)
    return tail / math.log(10)
