"""Do neighbouring matches keep their orientation, or was one of the photographs mirrored?

No motion of a camera mirrors a scene: three neighbouring points of a surface that face the camera
in both photographs are met in the same order, clockwise or not. Between a photograph and its mirror
image the order is reversed, and parallel epipolar lines fit the matches perfectly all the same, so
that the number of inliers says nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError
from torch import Tensor

# A triangle whose height is below this many pixels may be turned over by noise alone.
_HEIGHT_PX = 3.0
# Matches at most, for speed; about 8,000 triangles make the standard deviation of a share 0.8 %.
_MATCHES = 4_000
# Correct pairs measured: 0 to 6 % reversed by depth (Oxford, fountain, temple ring neighbours), and
# 20 % for points of random depth without any surface. Photographs against their mirror images: 52
# to 76 %. Matches of unrelated points: half.
REVERSED_BY_DEPTH, MOST_REVERSED = 0.20, 0.35


@dataclass(frozen=True)
class Handedness:
    """Orientation of the triangles between neighbouring matches.

    Attributes:
        kept: triangles with the same orientation in both images.
        reversed: triangles with opposite orientations.
        limit: share of reversed triangles that a correct geometry can have.
    """

    kept: int
    reversed: int
    limit: float = MOST_REVERSED

    @property
    def share_kept(self) -> float:
        """Share of the triangles that keep their orientation; NaN where there are none."""
        count = self.kept + self.reversed
        return self.kept / count if count else math.nan

    @property
    def inconsistent(self) -> bool:
        """Whether more triangles are reversed than any view of one scene reverses.

        A one-sided test at 1 % against `limit`. The triangles share their points; half of them,
        about one per point, count as independent.
        """
        count = self.kept + self.reversed
        spread = math.sqrt(2 * count * self.limit * (1 - self.limit))
        return self.reversed - self.limit * count > 2.33 * spread

    @property
    def mirrored(self) -> bool:
        """Whether it is inconsistent and most triangles are reversed."""
        return self.inconsistent and self.share_kept < 0.5


def reversed_limit(wrong: float) -> float:
    """Compute the share of reversed triangles that a share of wrong inliers accounts for.

    A triangle with a wrong corner is reversed with probability 1/2; depth reverses some more.
    """
    return min(MOST_REVERSED, REVERSED_BY_DEPTH + 0.5 * (1 - (1 - wrong) ** 3))


def handedness(x1: Tensor, x2: Tensor, wrong: float = 1.0) -> Handedness:
    """Count the triangles of neighbouring matches that keep and that reverse their orientation.

    Args:
        x1, x2: (N, 2) pixels of the inliers. The triangles are those of the Delaunay triangulation
            of at most 4,000 points of x1, in equal steps of their order, without those that are
            flat in either image.
        wrong: Expected share of inliers that agree by chance.
    """
    limit = reversed_limit(wrong)
    step = max(1, math.ceil(len(x1) / _MATCHES))
    a, b = (np.asarray(x[::step].detach().cpu(), dtype=np.float64) for x in (x1, x2))
    _, first = np.unique(np.round(a, 3), axis=0, return_index=True)
    a, b = a[first], b[first]
    if len(a) < 4:
        return Handedness(0, 0, limit)
    try:
        corners = Delaunay(a).simplices
    except QhullError:  # all on one line
        return Handedness(0, 0, limit)
    area1, area2 = _signed_area(a[corners]), _signed_area(b[corners])
    clear = np.minimum(_height(a[corners], area1), _height(b[corners], area2)) > _HEIGHT_PX
    kept = int((area1[clear] * area2[clear] > 0).sum())
    return Handedness(kept, int(clear.sum()) - kept, limit)


def _signed_area(triangles: np.ndarray) -> np.ndarray:
    """(T,) of (T, 3, 2) corners."""
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def _height(triangles: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(T,) the least height: twice the area over the longest side."""
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    return 2 * np.abs(area) / np.maximum(sides.max(axis=1), 1e-12)
