"""Minimal samples: in order of promise, weighted by what is known about each match, and repeatable."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_FIRST_POOLS = (0.1, 0.3)  # shares of the matches, best first, that the first rounds draw from
_SMALLEST_POOL = 100


class Sampler:
    """Draws minimal samples of distinct matches, and knows how likely it has missed a good one so far.

    PROSAC's idea on batches: the first rounds draw from the most promising matches only, later ones from all. Within a
    round every match has its own probability. Counting what has been tried, a round of n samples has missed every
    all-inlier sample with probability ``(1 - p^k)^n``, where p is the probability that one draw is an inlier.

    Source: Chum & Matas, "Matching with PROSAC - progressive sample consensus", CVPR 2005.
    """

    def __init__(self, n: int, size: int, generator: torch.Generator, prior: Tensor | None, quality: Tensor | None):
        """
        Args:
            n: matches. size: of a sample.
            prior: (n,) relative probability of a match to be drawn, not negative.
            quality: (n,) the smaller the more promising (distance ratio); NaN goes last.
        """
        self.size, self.generator = size, generator
        self.prior = torch.ones(n, dtype=torch.float64) if prior is None else prior.detach().double().cpu()
        self.order = None
        if quality is not None:
            self.order = torch.nan_to_num(quality.detach().double().cpu(), nan=torch.inf).argsort(stable=True)
        self.rounds: list[tuple[int, Tensor]] = []

    def draw(self, count: int) -> Tensor:
        """(about count, size) int64: one round. Samples in which a match came up twice are left out."""
        p = self._probabilities()
        self.rounds.append((count, p))
        if len(p) <= 512 or int((p > 0).sum()) <= 512:  # exact draws without replacement: Gumbel's top k
            noise = torch.empty(count, len(p), dtype=torch.float64).exponential_(generator=self.generator)
            return (p.log() - noise.log()).topk(self.size, dim=1).indices
        cumulative = p.cumsum(0)
        u = torch.rand(count, self.size, dtype=torch.float64, generator=self.generator) * cumulative[-1]
        samples = torch.searchsorted(cumulative, u, right=True).clamp(max=len(p) - 1)
        ascending = samples.sort(dim=1).values
        return samples[(ascending[:, 1:] != ascending[:, :-1]).all(1)]

    def _probabilities(self) -> Tensor:
        p = self.prior
        r = len(self.rounds)
        if self.order is not None and r < len(_FIRST_POOLS):
            pool = max(_SMALLEST_POOL, int(_FIRST_POOLS[r] * len(p)))
            p = torch.zeros_like(p).index_copy(0, self.order[:pool], p[self.order[:pool]])
        if int((p > 0).sum()) < self.size:
            p = torch.ones_like(p)
        return p / p.sum()

    def learn(self, groups: Tensor, inliers: Tensor, weights: Tensor | None) -> None:
        """Draw each group's matches (its operator's) in proportion to their share of inliers under the best model."""
        groups, inliers = groups.cpu(), inliers.cpu().double()
        total = torch.bincount(groups).double()
        rate = (torch.bincount(groups, inliers) + 1) / (total + 2)
        self.prior = rate[groups] if weights is None else rate[groups] * weights.detach().double().cpu()

    def log_missed(self, inliers: Tensor) -> float:
        """Logarithm of the probability that no sample so far consisted of inliers only."""
        inliers = inliers.double().cpu()
        log = 0.0
        for count, p in self.rounds:
            good = min(float(p @ inliers), 1 - 1e-12) ** self.size
            log += count * math.log1p(-good)
        return log
