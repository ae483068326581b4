"""Minimal samples: in order of quality, weighted, and repeatable."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_POOLS = (100, 300, 1000, 3000, None)  # matches, best first, that the rounds draw from in turn
_GRADES = 8  # of each measure of quality, within each group of matches
_SHRINK = (
    2.0  # matches of the average kind that each kind is credited with: a few do not make a rate
)
_SLIM = 1e-3  # chance of the worst kind: a wrong model must not rule matches out for good


class Sampler:
    """Draw minimal samples of distinct matches; compute the probability that no good one was drawn.

    PROSAC's idea on batches: some rounds draw from the matches of the best quality only, others
    from all. Within a round every match has its own probability, learned from the share of inliers
    of its kind under the best model so far. A round of n samples has missed every all-inlier
    sample with probability ``(1 - p^k)^n``, where p is the probability that one draw is an inlier.

    Source: Chum & Matas, "Matching with PROSAC - progressive sample consensus", CVPR 2005.
    """

    def __init__(
        self,
        n: int,
        size: int,
        generator: torch.Generator,
        weights: Tensor | None,
        quality: Tensor | None,
        groups: Tensor | None,
    ):
        """
        Args:
            n: matches. size: of a sample.
            weights: (n,) relative probability of a match to be drawn, not negative.
            quality: see :meth:`consider`.
            groups: (n,) int64, such as the operator that found a match.
        """
        self.size, self.generator = size, generator
        self.weights = (
            torch.ones(n, dtype=torch.float64)
            if weights is None
            else weights.detach().double().cpu()
        )
        self.prior = self.weights
        self.orders: list[Tensor] = []
        self.kind = None if groups is None else groups.detach().cpu()
        self.rounds: list[tuple[int, Tensor]] = []
        if quality is not None:
            self.consider(quality)

    def consider(self, quality: Tensor) -> None:
        """Draw in the order of one more measure of quality, in turn with the others.

        Args:
            quality: (n,) smaller for a better match; NaN goes last. Where all are NaN or infinite
                it is ignored: an arbitrary order would confine the search to a few matches.
        """
        q = quality.detach().double().cpu()
        if not bool(torch.isfinite(q).any()):
            return
        order = torch.nan_to_num(q, nan=torch.inf).argsort(stable=True)
        grade = torch.empty(len(q), dtype=torch.int64)
        grade[order] = torch.arange(len(q)) * _GRADES // len(q)
        self.orders.append(order)
        self.kind = grade if self.kind is None else self.kind * _GRADES + grade

    def draw(self, count: int) -> Tensor:
        """Draw one round, (about count, size) int64, without samples that repeat a match."""
        p = self._probabilities()
        self.rounds.append((count, p))
        drawn = p.nonzero().squeeze(1)
        if (
            len(drawn) <= 512
        ):  # exact draws without replacement: the shortest of exponential waiting times
            wait = torch.empty(count, len(drawn), dtype=torch.float64).exponential_(
                generator=self.generator
            )
            return drawn[(p[drawn] / wait).topk(self.size, dim=1).indices]
        cumulative = p.cumsum(0)
        u = (
            torch.rand(count, self.size, dtype=torch.float64, generator=self.generator)
            * cumulative[-1]
        )
        samples = torch.searchsorted(cumulative, u, right=True).clamp(max=len(p) - 1)
        ascending = samples.sort(dim=1).values
        return samples[(ascending[:, 1:] != ascending[:, :-1]).all(1)]

    def scoring_subset(self, count: int) -> Tensor:
        """Draw at most `count` distinct matches (int64), with the last round's probabilities."""
        p = self.rounds[-1][1]
        wait = torch.empty(len(p), dtype=torch.float64).exponential_(generator=self.generator)
        return (p / wait).topk(min(count, int((p > 0).sum()))).indices

    def _probabilities(self) -> Tensor:
        p = self.prior
        if self.orders:
            turn, which = divmod(len(self.rounds), len(self.orders))
            pool = self.orders[which][: _POOLS[turn % len(_POOLS)]]
            p = torch.zeros_like(p).index_copy(0, pool, p[pool])
        if int((p > 0).sum()) < self.size:
            p = torch.ones_like(p)
        return p / p.sum()

    def learn(self, inliers: Tensor) -> None:
        """Draw each kind of match in proportion to its share of inliers under a model.

        A kind is an operator and a grade of each measure of quality.
        """
        if self.kind is None:
            return
        inliers = inliers.cpu().double()
        total = torch.bincount(self.kind).double()
        rate = (torch.bincount(self.kind, inliers) + _SHRINK * inliers.mean()) / (total + _SHRINK)
        self.prior = rate[self.kind].clamp(min=_SLIM) * self.weights

    def log_missed(self, inliers: Tensor) -> float:
        """Compute the log of the probability that no sample so far had inliers only."""
        inliers = inliers.double().cpu()
        log = 0.0
        for count, p in self.rounds:
            good = min(float(p @ inliers), 1 - 1e-12) ** self.size
            log += count * math.log1p(-good)
        return log
