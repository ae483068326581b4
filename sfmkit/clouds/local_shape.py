"""Shape of a cloud around a point, from the eigenvalues of the covariance of its neighbours.

With the eigenvalues l1 >= l2 >= l3 of the covariance of the points within R (West et al. 2004;
Hackel, Wegner & Schindler, "Contour detection in unstructured 3D point clouds", CVPR 2016, Table 1;
Pauly, Gross & Kobbelt 2002 for the surface variation):

    linearity          (l1 - l2) / l1           1 on a line
    planarity          (l2 - l3) / l1           1 on a plane
    sphericity         l3 / l1                  1 where they fill space
    surface variation  l3 / (l1 + l2 + l3)      0 on a plane, up to 1/3; high on creases and corners
    border             |mean - point| / R       0 inside a surface, 4 / (3 pi) = 0.42 on its border
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import ceil

import numpy as np
from scipy.spatial import KDTree

from .._utils.progress import Progress
from .density import BLOCK, build_tree, check_radius

NEIGHBOURS = 20  # enough for a covariance; only isolated points have fewer
_PAIRS = 2_000_000  # neighbours per block


@dataclass(frozen=True, eq=False)
class LocalShape:
    """Shape around points of a cloud; NaN for a point with too few neighbours.

    Attributes:
        index: (M,) int64 rows of the points in their cloud.
        linearity, planarity, sphericity, surface_variation, border: (M,) float64 features, see
            the module.
    """

    index: np.ndarray
    linearity: np.ndarray
    planarity: np.ndarray
    sphericity: np.ndarray
    surface_variation: np.ndarray
    border: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Return (M,) bool, the points with enough neighbours."""
        return np.isfinite(self.linearity)

    def features(self) -> dict[str, np.ndarray]:
        """Return the five features by name."""
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
    """Compute the shape within `radius` of each point from the same number of neighbours.

    The covariance of few points is flatter than that of many points of the same shape, so features
    of all neighbours would depend on the density. Therefore 20 random neighbours are used for each
    point.

    Args:
        xyz: (N, 3) points.
        radius: Radius in the unit of the points.
        neighbours: (N,) numbers of neighbours, from
            :func:`sfmkit.clouds.density.count_neighbours`.
        most: Largest number of points; evenly spaced rows of a larger cloud are used.
        seed: Seed of the random neighbours.
        progress: Called with (stage, detail).

    Raises:
        InputError: The points or the radius are invalid.
    """
    check_radius(radius)
    shuffled = np.random.default_rng(seed).permutation(len(xyz))
    tree = build_tree(
        np.asarray(xyz)[shuffled]
    )  # the rows are shuffled, so the first rows of a neighbourhood are a random sample
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
    """Compute (5, M) features around (M, 3) points, all with enough neighbours."""
    lists = tree.query_ball_point(points, radius, return_sorted=True, workers=-1)
    near = tree.data[np.array([some[:NEIGHBOURS] for some in lists])]  # (M, 20, 3)
    mean = near.mean(1)
    away = near - mean[:, None]
    l3, l2, l1 = np.maximum(np.linalg.eigvalsh(away.mT @ away), 0).T
    border = np.linalg.norm(mean - points, axis=1) / radius
    with np.errstate(invalid="ignore"):  # coincident points have no shape: NaN
        return np.stack([(l1 - l2) / l1, (l2 - l3) / l1, l3 / l1, l3 / (l1 + l2 + l3), border])
