"""The shape of a cloud around a point, from the eigenvalues of its neighbours' covariance.

With the eigenvalues l1 >= l2 >= l3 of the covariance of the points within R (West et al. 2004;
Hackel, Wegner & Schindler, "Contour detection in unstructured 3D point clouds", CVPR 2016, Table 1;
Pauly, Gross & Kobbelt 2002 for the surface variation):

    linearity          (l1 - l2) / l1           1 on a line
    planarity          (l2 - l3) / l1           1 on a plane
    sphericity         l3 / l1                  1 where they fill space
    surface variation  l3 / (l1 + l2 + l3)      0 on a plane, up to 1/3; high on creases and corners
    border             |mean - point| / R       0 inside a surface, 4 / (3 pi) = 0.42 on the straight border of one
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import ceil

import numpy as np
from scipy.spatial import KDTree

from .._utils.progress import Progress
from .density import BLOCK, build_tree, check_radius

NEIGHBOURS = 20  # enough for a covariance, and few enough that all but lonely points have them
_PAIRS = 2_000_000  # neighbours listed at a time


@dataclass(frozen=True, eq=False)
class LocalShape:
    """The shape around some points of a cloud; NaN where a point has too few neighbours to tell.

    Attributes:
        index: (M,) int64 rows of the points in their cloud.
        linearity, planarity, sphericity, surface_variation, border: (M,) float64, see the module.
    """

    index: np.ndarray
    linearity: np.ndarray
    planarity: np.ndarray
    sphericity: np.ndarray
    surface_variation: np.ndarray
    border: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """(M,) bool: the points with neighbours enough."""
        return np.isfinite(self.linearity)

    def features(self) -> dict[str, np.ndarray]:
        """The five features by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "index"}


def local_shape(
    xyz: np.ndarray,
    radius: float,
    neighbours: np.ndarray,
    *,
    most: int = BLOCK,
    seed: int = 0,
    progress: Progress | None = None,
) -> LocalShape:
    """The shape within `radius` of each point, by the same number of neighbours everywhere.

    A covariance of few points looks thinner than that of many, so features of all the neighbours
    there are would vary with the density whatever the shape. Each point is therefore judged by 20
    of its neighbours, drawn at random.

    Args:
        xyz: (N, 3) points.
        radius: in their unit.
        neighbours: (N,) how many there are, from :func:`sfmkit.clouds.density.count_neighbours`.
        most: of a larger cloud this many points are judged, taken evenly.
        seed: of the draw.
        progress: called with (stage, detail).

    Raises:
        InputError: unusable points or radius.
    """
    check_radius(radius)
    shuffled = np.random.default_rng(seed).permutation(len(xyz))
    tree = build_tree(
        np.asarray(xyz)[shuffled]
    )  # the lowest row numbers of a neighbourhood are a random draw from it
    index = np.arange(0, len(xyz), ceil(len(xyz) / most))
    features = np.full((5, len(index)), np.nan)
    able = np.flatnonzero(neighbours[index] >= NEIGHBOURS)
    blocks = np.cumsum(neighbours[index[able]]) // _PAIRS
    for number, start in enumerate(starts := np.flatnonzero(np.diff(blocks, prepend=-1))):
        if progress is not None:
            progress("shape", f"around point {start:,} of {len(able):,}")
        rows = able[start : starts[number + 1] if number + 1 < len(starts) else None]
        features[:, rows] = _features(tree, xyz[index[rows]], radius)
    return LocalShape(index, *features)


def _features(tree: KDTree, points: np.ndarray, radius: float) -> np.ndarray:
    """(5, M) features around (M, 3) points that all have neighbours enough."""
    lists = tree.query_ball_point(points, radius, return_sorted=True, workers=-1)
    near = tree.data[np.array([some[:NEIGHBOURS] for some in lists])]  # (M, 20, 3)
    mean = near.mean(1)
    away = near - mean[:, None]
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(away.mT @ away), 0).T
    border = np.linalg.norm(mean - points, axis=1) / radius
    with np.errstate(invalid="ignore"):  # copies of one place have no shape: NaN
        return np.stack([(l1 - l2) / l1, (l2 - l3) / l1, l3 / l1, l3 / (l1 + l2 + l3), border])
