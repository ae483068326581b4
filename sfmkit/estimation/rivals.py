"""Rival motions: is there another pose with a comparable set of matches of equal quality?

Repeated texture matches to shifted copies of itself. Where the photographs overlap, the right ones
win, because their descriptors agree better than those of any other copy. Where they do not
overlap, the best motion is one of several with equal claims. Both are measured on the matches that
the best motion does not explain: how many of them agree on another motion, and whether the distance
ratios of the best motion's matches are smaller than theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..geometry.coordinates import normalize
from ..geometry.essential import decompose_essential
from ..geometry.fundamental import fundamental_from_essential, squared_sampson_distance
from ..geometry.pose import choose_pose, rotation_error, translation_error
from .chance import MAX_LOG10_NFA, chance_agreement, log10_nfa
from .robust import estimate

__all__ = ["LEAST_ODDS", "LEAST_SHARE", "Rival", "find_rival", "quality_odds"]

# A rival counts if it has this share of the support of the best motion, and if a match of the best
# motion is not better than one of the rival with these odds.
LEAST_SHARE, LEAST_ODDS = 0.1, 3.0
_APART = 3.0  # thresholds beyond which a match is not explained by the best motion
_MATCHES, _SAMPLES = 2_000, 512  # of the search
_SAME_DEG = 2.0  # motions that differ by less are one


@dataclass(frozen=True, eq=False)
class Rival:
    """Another motion that explains matches which the best one does not.

    Attributes:
        R, t: (3, 3) and (3,), t of unit length.
        inliers: Its matches.
        share: Its inliers over those of the best motion.
        log10_false_alarms: Motions with this many inliers to expect by chance.
        odds: That the distance ratio of a match of the best motion is smaller than that of a match
            of the rival; NaN where the ratios are unknown.
    """

    R: Tensor
    t: Tensor
    inliers: int
    share: float
    log10_false_alarms: float
    odds: float

    @property
    def comparable(self) -> bool:
        """Whether it has enough support of the same quality to doubt the best motion."""
        return (
            self.log10_false_alarms < MAX_LOG10_NFA
            and self.share >= LEAST_SHARE
            and not self.odds >= LEAST_ODDS
        )


def find_rival(
    pose: tuple[Tensor, Tensor],
    F: Tensor,
    inliers: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    ratio: Tensor,
    threshold_px: float,
    seed: int = 0,
) -> Rival | None:
    """Search for a distinct motion among the matches that the best one does not explain.

    Args:
        pose: R, t of the best motion.
        F: (3, 3) its fundamental matrix.
        inliers: (N,) bool.
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        ratio: (N,) distance ratios, NaN where unknown.
        threshold_px: Largest distance of an inlier, pixels.
        seed: Of the search, and of the subset that is searched where there are many matches.

    Returns:
        The motion that most of these matches agree on, None where there is none or it is the best
        one again.
    """
    unexplained = squared_sampson_distance(F, x1, x2) > (_APART * threshold_px) ** 2
    rows = unexplained.nonzero().squeeze(1)
    generator = torch.Generator().manual_seed(seed)
    total = len(rows)
    rows = rows[torch.randperm(total, generator=generator)[:_MATCHES].to(rows.device)]
    a, b = x1[rows], x2[rows]
    found = estimate(
        a,
        b,
        K1,
        K2,
        threshold_px=threshold_px,
        max_iterations=_SAMPLES,
        seed=seed,
        ratio=ratio[rows],
    )
    if found.model is None:
        return None
    agree = found.inliers
    R, t, _ = choose_pose(
        *decompose_essential(found.model), normalize(a, K1)[agree], normalize(b, K2)[agree]
    )
    if max(float(rotation_error(R, pose[0])), float(translation_error(t, pose[1]))) < _SAME_DEG:
        return None
    other = fundamental_from_essential(found.model, K1, K2)
    chance = chance_agreement(
        lambda p, q: squared_sampson_distance(other, p, q), a, b, threshold_px, generator
    )
    k = int(agree.sum())
    count = round(k * total / len(rows))
    return Rival(
        R,
        t,
        count,
        count / max(int(inliers.sum()), 1),
        log10_nfa(k, len(rows), chance, sample=5, solutions=10),
        quality_odds(ratio[inliers], ratio[rows][agree]),
    )


def quality_odds(best: Tensor, rival: Tensor) -> float:
    """Compute the odds that a value of `best` is smaller than one of `rival`.

    The statistic of Mann and Whitney (1947), with ties counted half; NaN values are left out.

    Args:
        best, rival: (M,) and (N,) distance ratios.
    """
    a, b = (x[torch.isfinite(x)].double() for x in (best, rival))
    if not len(a) or not len(b):
        return float("nan")
    b = b.sort().values
    above = len(b) - torch.searchsorted(b, a, right=True)
    ties = torch.searchsorted(b, a, right=True) - torch.searchsorted(b, a)
    wins = float((above + 0.5 * ties).sum()) / (len(a) * len(b))
    return wins / (1 - wins) if wins < 1 else float("inf")
