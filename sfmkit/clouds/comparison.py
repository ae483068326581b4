"""Comparison of two clouds of one object: counts, densities and distances.

The clouds may have different scales and frames.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from .._utils.progress import Progress
from ..types import PointCloud
from .alignment import Alignment, align
from .density import Density, build_tree, count_neighbours, density

_BLOCK = 200_000  # points per nearest-neighbour query


@dataclass(frozen=True)
class Distances:
    """Statistics of the distances from the points of one cloud to the other cloud.

    Attributes:
        median, p95, rms: Median, 95th percentile and root mean square. The last one depends mainly
            on a few distant points.
    """

    median: float
    p95: float
    rms: float

    @staticmethod
    def of(values: np.ndarray) -> Distances:
        return Distances(
            float(np.median(values)),
            float(np.percentile(values, 95)),
            float(np.sqrt(np.mean(np.square(values)))),
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two clouds in the frame of the first.

    Attributes:
        first: The first cloud.
        second: The second cloud in the frame and unit of the first.
        alignment: The transformation and its quality.
        extent: Diagonal of the box of the inner 98 % of the first cloud in each direction.
        to_second, to_first: (N,) and (M,) distances to the nearest point of the other cloud, in the
            unit of the first cloud.
        density_first, density_second: Densities with the same radius, in the unit of the first
            cloud.
    """

    first: PointCloud
    second: PointCloud
    alignment: Alignment
    extent: float
    to_second: np.ndarray
    to_first: np.ndarray
    density_first: Density
    density_second: Density

    def numbers(self) -> dict[str, Any]:
        """Return all results except the points as JSON values.

        Lengths are in the unit of the first cloud, or divided by its extent if the name says so.
        """
        move = self.alignment.similarity
        found: dict[str, Any] = {
            "alignment": {
                "scale": float(move.s),
                "rotation": move.R.tolist(),
                "shift": move.t.tolist(),
                "overlap": self.alignment.overlap,
                "residual": self.alignment.residual,
                "rivalry": self.alignment.rivalry,
                "doubtful": self.alignment.doubtful,
            },
            "extent": self.extent,
            "radius": self.density_first.radius,
        }
        for name, cloud, dense, distance in (
            ("first", self.first, self.density_first, self.to_second),
            ("second", self.second, self.density_second, self.to_first),
        ):
            summary = asdict(Distances.of(distance))
            n = dense.neighbours
            found[name] = {
                "points": len(cloud),
                "neighbours": {
                    "mean": float(n.mean()),
                    "std": float(n.std()),
                    "median": float(np.median(n)),
                },
                "surface_density": float(dense.surface.mean()),
                "distance": summary,
                "distance_over_extent": {
                    key: value / self.extent for key, value in summary.items()
                },
            }
        return found


def compare(
    first: PointCloud,
    second: PointCloud,
    *,
    radius: float | None = None,
    pairs: np.ndarray | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Comparison:
    """Register the second cloud to the first, and compare their densities and distances.

    Args:
        first, second: The clouds.
        radius: Radius of the density, in the unit of the first cloud; None for ten times the
            spacing of its points.
        pairs: (P, 2) rows of corresponding points of the clouds, see
            :func:`sfmkit.clouds.alignment.align`.
        seed: Seed of the alignment.
        progress: Called with (stage, detail).

    Raises:
        InputError: A cloud, the radius or the pairs are invalid.
        DegenerateGeometryError: The points of a cloud lie on a line.
    """
    a = first.xyz.numpy()
    alignment = align(a, second.xyz.numpy(), pairs, seed=seed, progress=progress)
    moved = replace(second, xyz=alignment.similarity.apply(second.xyz), covariance=None)
    b = moved.xyz.numpy()
    tree_a, tree_b = build_tree(a), build_tree(b)
    found = density(a, radius, progress=progress)
    if progress is not None:
        progress("measure", "distances both ways")
    return Comparison(
        first=first,
        second=moved,
        alignment=alignment,
        extent=float(np.linalg.norm(np.ptp(np.percentile(a, (1, 99), axis=0), axis=0))),
        to_second=_nearest(tree_b, a),
        to_first=_nearest(tree_a, b),
        density_first=found,
        density_second=Density(
            found.radius, count_neighbours(tree_b, found.radius, progress=progress)
        ),
    )


def _nearest(tree: KDTree, points: np.ndarray) -> np.ndarray:
    """Compute the (N,) distances from points to the nearest point of a tree."""
    blocks = np.array_split(points, -(-len(points) // _BLOCK))
    return np.concatenate([tree.query(block, workers=-1)[0] for block in blocks])
