"""Cross-validation of a motion: halves of the image must find it, and support each other.

Matches of one tile of the image are not independent: a repeated element gives dozens of equal wrong
matches. So whole tiles are held out. The motion is searched anew on a random half of the tiles, and
the matches of the other half that agree with it are compared with chance. A wrong motion that
repeated texture or a single object suggests is rarely found in both halves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from statistics import median

import torch
from torch import Tensor

from ..geometry.coordinates import normalize
from ..geometry.essential import decompose_essential
from ..geometry.fundamental import fundamental_from_essential, squared_sampson_distance
from ..geometry.pose import choose_pose, rotation_error, translation_error
from .chance import MAX_LOG10_NFA, chance_agreement, log10_tail
from .robust import estimate

__all__ = ["MOST_APART_DEG", "Halves", "cross_validate"]

MOST_APART_DEG = 10.0  # median difference of the motions of the halves from the whole
_SPLITS = 2
_TILES = 16  # along the longer side of image 1
_SAMPLES = 2_000  # of each search


@dataclass(frozen=True)
class Halves:
    """What halves of the image say about a motion.

    Attributes:
        log10_p: Per half, log10 of the probability that so many matches of the other half agree
            with its motion by chance; 0 where it finds no motion.
        apart_deg: Per half, the difference of its motion from that of all matches, the larger of
            rotation and axis of the translation, degrees.
    """

    log10_p: tuple[float, ...]
    apart_deg: tuple[float, ...]

    @property
    def consistent(self) -> bool:
        """Whether every half is supported by its other half and most find the same motion."""
        return max(self.log10_p) < MAX_LOG10_NFA and median(self.apart_deg) <= MOST_APART_DEG


def cross_validate(
    R: Tensor,
    t: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    size_wh: tuple[int, int],
    ratio: Tensor,
    groups: Tensor,
    threshold_px: float,
    seed: int = 0,
) -> Halves:
    """Search the motion on halves of the tiles of image 1, for two random divisions.

    Args:
        R, t: (3, 3) and (3,), the motion of all matches.
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        size_wh: Size of image 1.
        ratio: (N,) distance ratios, NaN where unknown.
        groups: (N,) int64, the operator of each match.
        threshold_px: Largest distance of an inlier, pixels.
        seed: Of the divisions and the searches.
    """
    generator = torch.Generator().manual_seed(seed)
    cell = (x1 / (max(size_wh) / _TILES)).floor().long()
    _, tile = torch.unique(cell, dim=0, return_inverse=True)
    tails, apart = [], []
    for _ in range(_SPLITS):
        side = torch.rand(int(tile.max()) + 1, generator=generator).to(x1.device) < 0.5
        for half in (side[tile], ~side[tile]):
            found = estimate(
                x1[half],
                x2[half],
                K1,
                K2,
                threshold_px=threshold_px,
                max_iterations=_SAMPLES,
                seed=seed,
                ratio=ratio[half],
                groups=groups[half],
            )
            if found.model is None or int((~half).sum()) < 2:
                tails.append(0.0)
                apart.append(180.0)
                continue
            F = fundamental_from_essential(found.model, K1, K2)
            a, b = x1[~half], x2[~half]
            chance = chance_agreement(
                partial(squared_sampson_distance, F), a, b, threshold_px, generator
            )
            agree = int((squared_sampson_distance(F, a, b) < threshold_px**2).sum())
            tails.append(log10_tail(agree, len(a), chance))
            apart.append(_apart(found.model, found.inliers, x1[half], x2[half], K1, K2, R, t))
    return Halves(tuple(tails), tuple(apart))


def _apart(
    E: Tensor, inliers: Tensor, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, R: Tensor, t: Tensor
) -> float:
    Q, u, _ = choose_pose(
        *decompose_essential(E), normalize(x1, K1)[inliers], normalize(x2, K2)[inliers]
    )
    axis = float(translation_error(u, t))
    return max(float(rotation_error(Q, R)), min(axis, 180 - axis))
