"""What speaks against a motion that chance does not explain: rivals, operators, halves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from torch import Tensor

from ..types import Correspondences, Verdict
from .halves import Halves, cross_validate
from .rivals import Rival, find_rival
from .witnesses import Witness, operator_witnesses, unsupported

__all__ = ["Scrutiny", "scrutinise"]

# Halves are searched where less than this share of the matches, and fewer than this number, agree.
# Where most matches agree there is no room for another motion; many inliers are found again in
# every half (docs/results-verdict.md).
_MAJORITY, _MANY = 0.5, 500
_LEAST_UNEXPLAINED = 16  # matches among which a rival is searched


@dataclass(frozen=True, eq=False)
class Scrutiny:
    """The doubts about a motion.

    Attributes:
        witnesses: operator -> what its matches say about the pose of the other operators.
        rival: Another motion among the matches that this one does not explain, None without one.
        halves: Cross-validation over the image, None where it was not needed.
    """

    witnesses: Mapping[str, Witness]
    rival: Rival | None
    halves: Halves | None

    @property
    def verdict(self) -> Verdict | None:
        """The verdict that the doubts demand, None where there are none."""
        if self.rival is not None and self.rival.comparable:
            return Verdict.AMBIGUOUS
        if unsupported(self.witnesses) or (self.halves and not self.halves.consistent):
            return Verdict.TOO_LITTLE
        return None

    @property
    def reason(self) -> str:
        """The verdict in words; empty where there are no doubts."""
        if self.rival is not None and self.rival.comparable:
            odds = self.rival.odds
            quality = "" if math.isnan(odds) else _quality(odds)
            return (
                f"{self.rival.inliers:,} matches that this motion does not explain agree on "
                f"another one, {self.rival.share:.0%} of its own number{quality}: repeated texture "
                "allows more than one motion. The other is kept as an alternative."
            )
        if unsupported(self.witnesses):
            able = [f"{n} {w.inliers:,} of {w.matches:,}" for n, w in self.witnesses.items()]
            return (
                "Fewer than two operators support the motion that the others determine "
                f"({', '.join(able)} matches agree)."
            )
        if self.halves and not self.halves.consistent:
            return (
                "Halves of the image do not find one motion: they differ by "
                f"{median(self.halves.apart_deg):.0f} degrees in the median, and the weakest is "
                f"supported by the rest of the image with 10^{max(self.halves.log10_p):.0f} by "
                "chance."
            )
        return ""

    @property
    def evidence(self) -> dict[str, float]:
        """The numbers that it rests on."""
        numbers: dict[str, float] = {}
        if self.rival is not None:
            numbers |= {
                "rival_inliers": self.rival.inliers,
                "rival_share": self.rival.share,
                "rival_log10_false_alarms": self.rival.log10_false_alarms,
                "quality_odds": self.rival.odds,
            }
        if self.halves is not None:
            numbers |= {
                "halves_log10_chance": max(self.halves.log10_p),
                "halves_apart_deg": median(self.halves.apart_deg),
            }
        return numbers


def _quality(odds: float) -> str:
    if odds < 1:
        return ", and their descriptors are at least as distinctive"
    return f", and this motion's matches are the more distinctive ones with odds of only {odds:.1f}"


def scrutinise(
    R: Tensor,
    t: Tensor,
    F: Tensor,
    inliers: Tensor,
    corr: Correspondences,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    size_wh: tuple[int, int],
    threshold_px: float,
    seed: int,
) -> Scrutiny:
    """Look for what speaks against a motion.

    Args:
        R, t, F: (3, 3), (3,) and (3, 3) of the motion.
        inliers: (N,) bool.
        corr: Operators and distance ratios of the matches.
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        size_wh: Size of image 1.
        threshold_px: Largest distance of an inlier, pixels.
        seed: Of all searches.
    """
    count = int(inliers.sum())
    motion = R, t
    witnesses = operator_witnesses(
        R, t, inliers, x1, x2, K1, K2, corr.operator_id, corr.operators, threshold_px, seed
    )
    rival = halves = None
    if len(corr) - count >= _LEAST_UNEXPLAINED:
        rival = find_rival(motion, F, inliers, x1, x2, K1, K2, corr.ratio, threshold_px, seed)
    if count < min(_MANY, _MAJORITY * len(corr)):
        halves = cross_validate(
            R, t, x1, x2, K1, K2, size_wh, corr.ratio, corr.operator_id, threshold_px, seed
        )
    return Scrutiny(witnesses, rival, halves)
