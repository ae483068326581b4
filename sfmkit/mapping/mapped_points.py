"""Points of a model with the operators that found them, and statistics per operator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from ..errors import ImageError
from ..io.images import read_image
from ..pipeline.account import ALL
from ..types import PointCloud
from .collection import Collection
from .keypoint_lists import KeypointList

__all__ = ["MappedPoints", "OperatorTracks", "colour_points", "map_points", "track_statistics"]


@dataclass(frozen=True, eq=False)
class MappedPoints:
    """The points of a model.

    Attributes:
        xyz: (P, 3) float64 in the world of the model.
        error: (P,) float64 mean reprojection error, pixels.
        point: (T,) int64 row of the point of every observation.
        image, row: (T,) int64 photograph, and row in its keypoint list, of every observation.
        masks: (P,) int64, one bit per operator that found the point.
        main: (P,) int64 number of the operator with the most keypoints in the track.
        ids: (P,) int64 ids of the points in the model.
    """

    xyz: np.ndarray
    error: np.ndarray
    point: np.ndarray
    image: np.ndarray
    row: np.ndarray
    masks: np.ndarray
    main: np.ndarray
    ids: np.ndarray

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def lengths(self) -> np.ndarray:
        """The (P,) int64 number of observations of every point."""
        return np.bincount(self.point, minlength=len(self.xyz))


def map_points(model: Any, lists: Mapping[int, KeypointList], n_operators: int) -> MappedPoints:
    """Read the points of a model, and determine which operators found them.

    An operator found a point if it has a keypoint in at least two observations of the track,
    because a single keypoint was not matched.

    Args:
        model: ``pycolmap.Reconstruction`` from a database of sfmkit; its image ids are the
            positions of the photographs plus one.
        lists: Keypoints of the database.
        n_operators: Number of operators.
    """
    points = list(model.points3D.items())
    lengths = [p.track.length() for _, p in points]
    pairs = np.array(
        [(e.image_id - 1, e.point2D_idx) for _, p in points for e in p.track.elements], np.int64
    ).reshape(-1, 2)
    point = np.repeat(np.arange(len(points)), lengths)
    seen = np.zeros(len(pairs), np.int64)
    for index, found in lists.items():
        rows = pairs[:, 0] == index
        seen[rows] = found.masks[pairs[rows, 1]]
    counts = np.zeros((len(points), n_operators), np.int64)
    for k in range(n_operators):
        counts[:, k] = np.bincount(point, (seen >> k) & 1, minlength=len(points))
    bits = np.left_shift(1, np.arange(n_operators, dtype=np.int64))
    masks = ((counts >= 2) * bits).sum(1)
    lone = masks == 0  # tracks that the mapper has shortened
    masks[lone] = ((counts[lone] >= 1) * bits).sum(1)
    return MappedPoints(
        np.array([p.xyz for _, p in points]).reshape(-1, 3),
        np.array([p.error for _, p in points], np.float64),
        point,
        pairs[:, 0],
        pairs[:, 1],
        masks,
        counts.argmax(1) if len(points) else np.zeros(0, np.int64),
        np.array([k for k, _ in points], np.int64),
    )


def colour_points(
    points: MappedPoints, collection: Collection, lists: Mapping[int, KeypointList]
) -> np.ndarray:
    """Compute the mean colours of the observations of every point: (P, 3) uint8.

    The photographs are read upright, one at a time.
    """
    sums, counts = np.zeros((len(points), 3)), np.zeros(len(points))
    for index in np.unique(points.image):
        try:
            rgb = read_image(collection.photographs[index].path).rgb
        except ImageError:
            continue
        rows = points.image == index
        x, y = np.rint(lists[int(index)].xy[points.row[rows]]).astype(int).T
        h, w = rgb.shape[:2]
        np.add.at(sums, points.point[rows], rgb[y.clip(0, h - 1), x.clip(0, w - 1)])
        np.add.at(counts, points.point[rows], 1)
    return np.rint(sums / np.maximum(counts, 1)[:, None]).astype(np.uint8)


def cloud_of(points: MappedPoints, rgb: np.ndarray, operators: Sequence[str]) -> PointCloud:
    """Make a cloud for :func:`sfmkit.io.ply.write_ply`, in the world of the model."""
    n = len(points)
    return PointCloud(
        torch.from_numpy(points.xyz),
        torch.from_numpy(rgb),
        torch.from_numpy(points.main),
        torch.from_numpy(points.masks),
        tuple(operators),
        torch.from_numpy(points.error),
        torch.full((n,), float("nan"), dtype=torch.float64),
        torch.from_numpy(points.ids),
    )


@dataclass(frozen=True)
class OperatorTracks:
    """Statistics of the tracks of one operator, or of all (``multi``).

    Attributes:
        points: Number of points that it found, alone or with others.
        alone: Number of points that no other operator found.
        share: `points` over all points.
        track_length: Mean number of photographs per point.
        error_px: Mean reprojection error, pixels.
        error_alone_px: The same for the points of `alone`; NaN without such points.
    """

    points: int
    alone: int
    share: float
    track_length: float
    error_px: float
    error_alone_px: float

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as JSON values, without NaN."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


def track_statistics(points: MappedPoints, operators: Sequence[str]) -> dict[str, OperatorTracks]:
    """Compute the statistics of every operator and, last, of all together."""
    lengths = points.lengths

    def line(mine: np.ndarray, alone: np.ndarray) -> OperatorTracks:
        n = int(mine.sum())
        return OperatorTracks(
            n,
            int(alone.sum()),
            n / len(points) if len(points) else 0.0,
            _mean(lengths[mine]),
            _mean(points.error[mine]),
            _mean(points.error[alone]),
        )

    found = {
        name: line((points.masks >> k & 1).astype(bool), points.masks == 1 << k)
        for k, name in enumerate(operators)
    }
    everything = np.ones(len(points), bool)
    return found | {ALL: line(everything, everything)}


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")
