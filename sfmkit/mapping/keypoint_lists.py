"""One list of keypoints per photograph, of all operators, with their provenance.

COLMAP and hloc have one list of keypoints per image. With separate rows for each operator, a corner
found by two operators would become two tracks. Keypoints are therefore merged as in the fusion of a
pair: two keypoints of a photograph become one row if their matches were merged in at least one
pair, that is, if they coincide in both photographs of the pair. Merging is greedy: the keypoint
with the most inliers is merged with the keypoints that coincide with it, then the best of the
remaining ones. This prevents chains of neighbours from being merged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..ablation.entry import Entry
from ..matching import absorb
from .matched_folder import MatchedFolder

__all__ = ["KeypointList", "RowMatches", "list_all_keypoints", "list_keypoints", "match_rows"]


@dataclass(frozen=True, eq=False)
class KeypointList:
    """The keypoints of a photograph.

    Attributes:
        xy: (N, 2) float32 pixels, centre of the top-left pixel (0, 0).
        row: (M,) int32 row in `xy` of every keypoint of every operator, in the order of the
            operators.
        starts: Operator -> position of its first keypoint in `row`.
        size_wh: Width and height of the photograph, pixels.
    """

    xy: np.ndarray
    row: np.ndarray
    starts: Mapping[str, int]
    size_wh: tuple[int, int]

    @cached_property
    def operator(self) -> np.ndarray:
        """The (M,) int32 number of the operator of every keypoint."""
        starts = np.array([*self.starts.values(), len(self.row)])
        return np.repeat(np.arange(len(self.starts), dtype=np.int32), np.diff(starts))

    @cached_property
    def index(self) -> np.ndarray:
        """The (M,) int32 row of every keypoint in the features of its operator."""
        starts = np.array([*self.starts.values()], np.int32)
        return np.arange(len(self.row), dtype=np.int32) - starts[self.operator]

    @cached_property
    def masks(self) -> np.ndarray:
        """The (N,) int64 masks with one bit per operator that has a keypoint in the row."""
        masks = np.zeros(len(self.xy), np.int64)
        np.bitwise_or.at(masks, self.row, np.left_shift(1, self.operator.astype(np.int64)))
        return masks


@dataclass(frozen=True, eq=False)
class RowMatches:
    """The distinct matches of a pair as rows of the keypoint lists.

    Attributes:
        rows: (M, 2) int64 rows in both lists.
        ratio: (M,) float32, the smallest ratio of the merged matches.
        inlier: (M,) bool.
    """

    rows: np.ndarray
    ratio: np.ndarray
    inlier: np.ndarray


def list_all_keypoints(matched: MatchedFolder) -> dict[int, KeypointList]:
    """Make the keypoint lists of all photographs with at least one pair that did not fail."""
    used = {
        int(photograph)
        for row, pair in enumerate(matched.plan.pairs)
        if matched.plan.task(row).key not in matched.failures
        for photograph in pair
    }
    return {photograph: list_keypoints(matched, photograph) for photograph in sorted(used)}


def list_keypoints(matched: MatchedFolder, photograph: int) -> KeypointList:
    """Make the keypoint list of a photograph."""
    operators = matched.plan.recipe.operators
    features = {name: matched.features(photograph, name) for name in operators}
    counts = [len(f) for f in features.values()]
    starts = dict(zip(operators, np.cumsum([0, *counts[:-1]]).tolist()))
    xy = np.concatenate([f.keypoints for f in features.values()])
    weight = np.zeros(len(xy), np.int64)
    edges = [np.zeros((0, 2), np.int64)]
    for entry, side in _pairs_of(matched, photograph):
        raw = raw_rows(entry, side, starts)
        np.add.at(weight, raw[entry.arrays["inlier"]], 1)
        ends = np.stack([raw, raw[entry.arrays["leader"]]], axis=1)
        edges.append(np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0))
    rank = np.empty(len(xy), np.int64)
    rank[np.lexsort((np.arange(len(xy)), -weight))] = np.arange(len(xy))
    u, v = np.unique(np.concatenate(edges), axis=0).T
    leader = absorb(u, v, rank)
    kept, row = np.unique(leader, return_inverse=True)
    size_wh = matched.plan.collection.photographs[photograph].size_wh
    return KeypointList(xy[kept], row.astype(np.int32), starts, size_wh)


def _pairs_of(matched: MatchedFolder, photograph: int) -> Iterator[tuple[Entry, int]]:
    """Yield the results of the pairs of a photograph, and its position (0 or 1) in each pair."""
    for row in np.flatnonzero((matched.plan.pairs == photograph).any(1)):
        entry = matched.geometry(int(row))
        if isinstance(entry, Entry):
            yield entry, int(matched.plan.pairs[row, 1] == photograph)


def raw_rows(entry: Entry, side: int, starts: Mapping[str, int]) -> np.ndarray:
    """Return (M,) int64 positions of the matched keypoints in :attr:`KeypointList.row`."""
    first = np.array([*starts.values()], np.int64)
    return first[entry.arrays["operator"]] + entry.arrays[f"index{side + 1}"]


def match_rows(entry: Entry, first: KeypointList, second: KeypointList) -> RowMatches:
    """Convert the matches of a pair to rows of two keypoint lists; inliers are preferred."""
    a = entry.arrays
    ends = np.stack(
        [
            first.row[raw_rows(entry, 0, first.starts)],
            second.row[raw_rows(entry, 1, second.starts)],
        ],
        axis=1,
    ).astype(np.int64)
    rows, where = np.unique(ends, axis=0, return_inverse=True)
    ratio = np.full(len(rows), np.inf, np.float32)
    np.fmin.at(ratio, where, a["ratio"])
    inlier = np.zeros(len(rows), bool)
    np.logical_or.at(inlier, where, a["inlier"])
    return RowMatches(rows, ratio, inlier)
