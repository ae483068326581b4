"""Independent witnesses: does each operator alone support a pose that the others determined?

The matches of one operator are held out, the pose is refined on the inliers of the others, and the
held-out matches that agree with it are compared with the number that chance gives. Their agreement
did not enter the pose, so a binomial tail is exact up to the dependence of neighbouring matches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from ..geometry.fundamental import fundamental_from_pose, squared_sampson_distance
from ..geometry.refinement import refine_essential
from .chance import MAX_LOG10_NFA, chance_agreement, log10_tail

__all__ = ["Witness", "operator_witnesses", "unsupported"]

_LEAST = 8  # inliers of the other operators that the pose is refined on
_REFINED_ON = 1_000  # inliers at most, for speed


@dataclass(frozen=True)
class Witness:
    """What the matches of one operator say about the pose of the others.

    Attributes:
        matches: Number of its matches.
        inliers: Of those, in agreement with the pose that the other operators determine.
        chance: Probability that a wrong match of the operator agrees.
        log10_p: log10 of the probability of at least so many inliers by chance.
        log10_p_expected: The same if its share of inliers were that of all operators together.
    """

    matches: int
    inliers: int
    chance: float
    log10_p: float
    log10_p_expected: float

    @property
    def supports(self) -> bool:
        """Whether chance does not explain the agreement."""
        return self.log10_p < MAX_LOG10_NFA

    @property
    def could_support(self) -> bool:
        """Whether it has enough matches to support a pose as well as all operators together."""
        return self.log10_p_expected < MAX_LOG10_NFA


def operator_witnesses(
    R: Tensor,
    t: Tensor,
    inliers: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    operator_id: Tensor,
    operators: tuple[str, ...],
    threshold_px: float,
    seed: int = 0,
) -> dict[str, Witness]:
    """Hold out each operator and count its agreement with the pose of the others.

    Args:
        R, t: (3, 3) and (3,) of the pose of all operators.
        inliers: (N,) bool.
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        operator_id: (N,) int64 into `operators`; a match that several found counts for the one
            whose position was kept.
        threshold_px: Largest distance of an inlier, pixels.
        seed: Of the measurement of chance agreement.

    Returns:
        operator -> witness, for operators with at least two matches; empty for a single operator,
        which has no others.
    """
    found: dict[str, Witness] = {}
    share = float(inliers.double().mean())
    for k, name in enumerate(operators):
        mine = operator_id == k
        others = (inliers & ~mine).nonzero().squeeze(1)
        n = int(mine.sum())
        if n < 2 or len(others) < _LEAST:
            continue
        step = max(1, len(others) // _REFINED_ON)
        rows = others[::step]
        Q, u = refine_essential(R, t, x1[rows], x2[rows], K1, K2).pose
        F = fundamental_from_pose(Q, u, K1, K2)
        a, b = x1[mine], x2[mine]
        chance = chance_agreement(
            partial(squared_sampson_distance, F),
            a,
            b,
            threshold_px,
            torch.Generator().manual_seed(seed),
        )
        agree = int((squared_sampson_distance(F, a, b) < threshold_px**2).sum())
        found[name] = Witness(
            n, agree, chance, log10_tail(agree, n, chance), log10_tail(round(share * n), n, chance)
        )
    return found


def unsupported(witnesses: Mapping[str, Witness]) -> bool:
    """Whether fewer than two operators support the pose, of those that could.

    One is enough where only one operator has enough matches.
    """
    able = sum(witness.could_support for witness in witnesses.values())
    return sum(witness.supports for witness in witnesses.values()) < min(2, able)
