"""Density of a cloud around each of its points, with the definition of CloudCompare.

The neighbours of a point are the points at a distance of at most R, the point itself included, so
the smallest count is 1. CloudCompare's "Number of neighbors" has the same definition; the tests
compare both for every point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, isfinite, pi, sqrt

import numpy as np
from scipy.spatial import KDTree

from .._utils.progress import Progress
from ..errors import InputError

# Results in about 95 neighbours on the clouds of this project; the clouds of the paper have 115.
RADIUS_IN_SPACINGS = 10
MAX_PAIRS = 20_000_000_000  # neighbours of all points together: minutes on two cores
BLOCK = 100_000  # points between two reports of progress
_PROBES = 1_000  # points for the estimate of the cost


@dataclass(frozen=True, eq=False)
class Density:
    """Density at each point of a cloud.

    Attributes:
        radius: R, in the unit of the cloud.
        neighbours: (N,) int64 numbers of points within R, the point itself included.
    """

    radius: float
    neighbours: np.ndarray

    @cached_property
    def surface(self) -> np.ndarray:
        """Return (N,) neighbours per squared unit, ``n / (pi R^2)``, exact on a plane."""
        return self.neighbours / (pi * self.radius**2)

    @cached_property
    def volume(self) -> np.ndarray:
        """Return (N,) neighbours per cubed unit, ``n / (4/3 pi R^3)``."""
        return self.neighbours / (4 / 3 * pi * self.radius**3)


@dataclass(frozen=True, eq=False)
class Histogram:
    """Counts in classes of equal width, with a Gaussian of equal mean and standard deviation.

    Attributes:
        edges: (C + 1,) bounds of the classes.
        counts: (C,) int64.
        mean, std: Mean and standard deviation (divisor N) of the values.
    """

    edges: np.ndarray
    counts: np.ndarray
    mean: float
    std: float

    @property
    def classes(self) -> int:
        return len(self.counts)

    def gaussian(self, x: np.ndarray) -> np.ndarray:
        """Return the expected count of a normal distribution in a class around `x`."""
        scale = self.counts.sum() * (self.edges[1] - self.edges[0]) / (self.std * sqrt(2 * pi))
        return scale * np.exp(-0.5 * ((x - self.mean) / self.std) ** 2)


def density(
    xyz: np.ndarray, radius: float | None = None, *, progress: Progress | None = None
) -> Density:
    """Compute the density of a cloud at each of its points.

    Args:
        xyz: (N, 3) points.
        radius: R in the unit of `xyz`; None for :func:`automatic_radius`.
        progress: Called with (stage, detail).

    Raises:
        InputError: As for :func:`count_neighbours` and :func:`automatic_radius`.
    """
    tree = build_tree(xyz)
    if radius is None:
        radius = RADIUS_IN_SPACINGS * spacing(tree)
    return Density(float(radius), count_neighbours(tree, radius, progress=progress))


def build_tree(xyz: np.ndarray) -> KDTree:
    """Build the search tree of (N, 3) points for the functions of this module.

    Raises:
        InputError: There are no points, they have another shape, or they are not finite.
    """
    xyz = np.ascontiguousarray(xyz, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise InputError(f"the points must have shape (N, 3), not {xyz.shape}")
    if not len(xyz):
        raise InputError("the cloud has no points")
    if not np.isfinite(xyz).all():
        raise InputError("the points hold NaN or infinite values; remove those first")
    return KDTree(xyz)


def spacing(tree: KDTree) -> float:
    """Return the median distance from a point to the nearest other one, in the unit of the points.

    At most 100,000 evenly spaced rows are used; coincident points do not count as other points.

    Raises:
        InputError: All points coincide.
    """
    some = tree.data[:: ceil(tree.n / BLOCK)]
    copies = tree.query_ball_point(some[:: ceil(len(some) / 100)], 0, return_length=True)
    # The nearest points are coincident, or a search is slow because there are so many of them.
    if copies.min() > 1 or copies.mean() > 100:
        tree = KDTree(_places(tree.data))
        some = tree.data[:: ceil(tree.n / BLOCK)]
    if tree.n == 1:
        raise InputError(
            "all points lie at one place, so the radius cannot be derived from their spacing; "
            "give --radius"
        )
    nearest = tree.query(some, k=2, workers=-1)[0][:, 1]
    return float(np.median(nearest[nearest > 0]))


def automatic_radius(xyz: np.ndarray) -> float:
    """Return ten times the :func:`spacing` of (N, 3) points.

    This radius is large enough for stable counts, and small enough to show detail.
    """
    return RADIUS_IN_SPACINGS * spacing(build_tree(xyz))


def count_neighbours(
    points: np.ndarray | KDTree, radius: float, *, progress: Progress | None = None
) -> np.ndarray:
    """Count the points within `radius` of each point, itself included.

    The points are processed in blocks and without lists of neighbours, so the memory does not grow
    with the counts.

    Args:
        points: (N, 3) points or their :func:`build_tree`.
        radius: Radius in the unit of the points; a point at a distance of exactly `radius` counts.
        progress: Called with (stage, detail).

    Returns:
        (N,) int64, at least 1.

    Raises:
        InputError: The points are invalid, or the radius is not a positive number or so large that
            counting would take hours.
    """
    tree = points if isinstance(points, KDTree) else build_tree(points)
    check_radius(radius)
    _check_cost(tree, radius)
    counts = np.empty(tree.n, dtype=np.int64)
    for start in range(0, tree.n, BLOCK):
        if progress is not None:
            progress("count", f"neighbours of point {start:,} of {tree.n:,}")
        # in the order of the tree, neighbours are in the processor cache
        rows = tree.indices[start : start + BLOCK]
        counts[rows] = tree.query_ball_point(
            tree.data[rows], radius, return_length=True, workers=-1
        )
    return counts


_MOST_CLASSES = 1_000_000  # 16 MB of edges and counts


def histogram(neighbours: np.ndarray, classes: int | None = None) -> Histogram:
    """Compute the histogram of neighbour counts and its Gaussian.

    Args:
        neighbours: (N,) integers.
        classes: Number of classes between the smallest and the largest count, as in CloudCompare,
            whose default is the square root of N, rounded up. Classes narrower than 1 may contain
            no integer, so empty classes at regular distances are an artefact. None avoids it with
            classes of integer width around integers, at most as many as that square root.

    Raises:
        InputError: There are no counts, a count is not a finite number below 2^53, or `classes` is
            less than one or more than a million.
    """
    neighbours = np.asarray(neighbours)
    if neighbours.ndim != 1 or neighbours.dtype.kind not in "iuf":
        raise InputError(
            f"the counts must be (N,) numbers, not {neighbours.shape} {neighbours.dtype}"
        )
    if not len(neighbours):
        raise InputError("a histogram needs at least one count")
    if not (np.abs(neighbours.astype(np.float64)) < 2.0**53).all():  # exact in float64
        raise InputError("the counts must be finite and below 2^53")
    low, high = int(neighbours.min()), int(neighbours.max())
    if classes is None:
        width = ceil((high - low + 1) / default_classes(len(neighbours)))
        edges = np.arange(low - 0.5, high + 0.5 + width, width)
    elif not 1 <= classes <= _MOST_CLASSES:
        raise InputError(f"a histogram needs 1 to {_MOST_CLASSES:,} classes, not {classes}")
    else:
        edges = np.linspace(low, max(high, low + 1), classes + 1)
    counts, _ = np.histogram(neighbours, edges)
    return Histogram(
        edges, counts.astype(np.int64), float(neighbours.mean()), float(neighbours.std())
    )


def default_classes(n: int) -> int:
    """Return the square root of the number of points, rounded up.

    It is 99 for 9,666 points and 451 for 203,122 points, two clouds of the paper.
    """
    return ceil(sqrt(n))


def check_radius(radius: float) -> None:
    """Raise InputError unless `radius` is a positive number."""
    if not (isfinite(radius) and radius > 0):
        raise InputError(
            f"the radius must be a positive number in the cloud's unit, not {radius:g}"
        )


def _check_cost(tree: KDTree, radius: float) -> None:
    """Raise InputError if all points together have more than MAX_PAIRS neighbours."""
    if tree.n**2 <= MAX_PAIRS:
        return
    probes = tree.data[:: ceil(tree.n / _PROBES)]
    # Small batches, so that a radius that contains all points is detected after the first one.
    mean, seen = 0.0, 0
    for part in np.array_split(probes, ceil(len(probes) / 10)):
        seen += len(part)
        mean += float(tree.query_ball_point(part, radius, return_length=True).sum())
        if mean / len(probes) * tree.n > MAX_PAIRS:
            break
    else:
        return
    raise InputError(
        f"a point has about {mean / seen:,.0f} others within {radius:g}, too many to count around "
        f"each of {tree.n:,}; take a smaller radius (the default is ten times the spacing of the "
        "points), or subsample the cloud"
    )


def _places(xyz: np.ndarray) -> np.ndarray:
    """Return the (M, 3) distinct points of (N, 3)."""
    xyz = xyz[np.lexsort(xyz.T)]
    return xyz[np.concatenate([[True], (np.diff(xyz, axis=0) != 0).any(1)])]
