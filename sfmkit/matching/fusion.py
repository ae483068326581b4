"""Fusion of the matches of several operators into one set of correspondences.

Dippold & Tsai concatenate the matches of the operators. If several operators find the same corner,
plain concatenation counts that corner several times: it has a larger weight in every fit, and
minimal samples drawn from it are degenerate. Here, coincident correspondences are merged into one
that records all operators that found it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree

from ..errors import InputError
from ..types import MAX_OPERATORS, Correspondences, Features, Matches, OperatorCounts


def fuse(
    matches: Mapping[str, tuple[Features, Features, Matches]],
    *,
    merge_radius: float | None = 1.0,
    cost: Mapping[str, np.ndarray] | None = None,
) -> Correspondences:
    """Merge the matches of all operators into one set of correspondences.

    Two correspondences coincide if their points lie within `merge_radius` of each other in both
    images. A point with two different partners is a conflict; both correspondences are kept, and
    the robust estimator decides between them.

    Merging is greedy: the most distinctive correspondence absorbs all that coincide with it, then
    the most distinctive of the rest, and so on. The measure is the ratio of the best to the
    second-best descriptor distance, which is comparable between operators, unlike the distance.
    Therefore, every correspondence is represented by a better or equal one within the radius, no
    two of those that are kept coincide, and chains of neighbours are not merged into one. Matches
    with equal ratios are ordered by the name of the operator and by row, so the result does not
    depend on the order of the operators. Matches without a ratio come last.

    Args:
        matches: Per operator, its features in image 1 and image 2 (N1, N2) and its matches (M).
        merge_radius: Radius in pixels; None concatenates without merging, as in the paper.
        cost: Per operator, (M,) numbers that replace the ratio. They must be comparable between
            operators and smaller for a better match.

    Returns:
        The correspondences in the order of the operators and of their matches.
        ``counts[operator].merged`` is the number of its matches that another match represents. That
        match may belong to the same operator: ORB finds one corner on several pyramid levels.

    Raises:
        InputError: There are no or too many operators, matches lie outside the features, the images
            have different sizes, or the radius is invalid.
    """
    return represent(matches, find_leaders(matches, merge_radius=merge_radius, cost=cost))


def represent(
    matches: Mapping[str, tuple[Features, Features, Matches]], leader: np.ndarray
) -> Correspondences:
    """Return the correspondences that remain when its leader represents every match.

    Args:
        matches: As for :func:`fuse`.
        leader: (M,) rows of :func:`find_leaders`.

    Returns:
        As for :func:`fuse`.
    """
    per_operator = list(matches.values())
    x1, x2 = _positions(per_operator)
    distance, ratio = (
        np.concatenate([getattr(m, name) for *_, m in per_operator])
        for name in ("distance", "ratio")
    )
    index1, index2 = (
        np.concatenate([getattr(m, name) for *_, m in per_operator])
        for name in ("index1", "index2")
    )
    operator_id = np.repeat(np.arange(len(matches)), [len(m) for _, _, m in per_operator])
    mask = np.left_shift(1, operator_id)
    np.bitwise_or.at(mask, leader, mask.copy())
    kept = leader == np.arange(len(x1))

    lost = np.bincount(operator_id[~kept], minlength=len(matches))
    counts = {
        name: OperatorCounts(keypoints=(len(f1), len(f2)), matches=len(m), merged=int(n))
        for (name, (f1, f2, m)), n in zip(matches.items(), lost)
    }

    def tensor(a: np.ndarray, dtype: type) -> torch.Tensor:
        return torch.from_numpy(a[kept].astype(dtype))

    return Correspondences(
        x1=tensor(x1, np.float64),
        x2=tensor(x2, np.float64),
        distance=tensor(distance, np.float64),
        ratio=tensor(ratio, np.float64),
        operator_id=tensor(operator_id, np.int64),
        operator_mask=tensor(mask, np.int64),
        index1=tensor(index1, np.int64),
        index2=tensor(index2, np.int64),
        operators=tuple(matches),
        counts=counts,
    )


def find_leaders(
    matches: Mapping[str, tuple[Features, Features, Matches]],
    *,
    merge_radius: float | None = 1.0,
    cost: Mapping[str, np.ndarray] | None = None,
) -> np.ndarray:
    """Find the match that represents each match after the merging of :func:`fuse`.

    Args:
        matches, merge_radius, cost: As for :func:`fuse`.

    Returns:
        (M,) int64 rows of the concatenated matches of all operators; a match that is kept has its
        own row.

    Raises:
        InputError: As for :func:`fuse`.
    """
    _check(matches, merge_radius)
    per_operator = list(matches.values())
    x1, x2 = _positions(per_operator)
    if merge_radius is None:
        return np.arange(len(x1))
    index1, index2, ratio = (
        np.concatenate([getattr(m, name) for *_, m in per_operator])
        for name in ("index1", "index2", "ratio")
    )
    name_order = np.repeat(
        np.argsort(np.argsort(list(matches))), [len(m) for _, _, m in per_operator]
    )
    rank = np.empty(len(x1), dtype=np.int64)
    worth = ratio if cost is None else np.concatenate([cost[name] for name in matches])
    rank[np.lexsort((index2, index1, name_order, worth))] = np.arange(len(x1))  # NaN sorts last
    return absorb(*_coincident(x1, x2, merge_radius), rank)


def _positions(
    per_operator: Sequence[tuple[Features, Features, Matches]],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the (M, 2) float64 pixels of the matches of all operators in both images."""
    x1 = np.concatenate([f1.keypoints[m.index1] for f1, _, m in per_operator])
    x2 = np.concatenate([f2.keypoints[m.index2] for _, f2, m in per_operator])
    return x1.astype(np.float64), x2.astype(np.float64)


def _check(
    matches: Mapping[str, tuple[Features, Features, Matches]], merge_radius: float | None
) -> None:
    if not matches:
        raise InputError("nothing to fuse: give the matches of at least one operator")
    if len(matches) > MAX_OPERATORS:
        raise InputError(f"at most {MAX_OPERATORS} operators can be fused, not {len(matches)}")
    if merge_radius is not None and not 0 <= merge_radius < np.inf:
        raise InputError(
            f"merge_radius must be a number of pixels, or None to merge nothing, not {merge_radius}"
        )
    sizes = {(f1.size_wh, f2.size_wh) for f1, f2, _ in matches.values()}
    if len(sizes) > 1:
        raise InputError(
            f"the features of the operators come from images of different sizes: {sorted(sizes)}; "
            "fuse matches of one pair of images"
        )
    for name, (f1, f2, m) in matches.items():
        for f, index in ((f1, m.index1), (f2, m.index2)):
            if len(index) and not (index.min() >= 0 and index.max() < len(f)):
                raise InputError(
                    f"the matches of '{name}' contain indices outside its {len(f)} features; they "
                    "may belong to other features"
                )


def _coincident(x1: np.ndarray, x2: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the pairs (u, v), u < v, of correspondences within the radius in both images."""
    tree = cKDTree(np.hstack([x1, x2]))
    u, v = tree.query_pairs(radius, p=np.inf, output_type="ndarray").T
    near = np.maximum(((x1[u] - x1[v]) ** 2).sum(1), ((x2[u] - x2[v]) ** 2).sum(1)) <= radius**2
    return u[near], v[near]


def absorb(u: np.ndarray, v: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Find the representative of every node of a graph by greedy absorption.

    The best-ranked node absorbs its neighbours, then the best-ranked of the rest, and so on.

    Args:
        u, v: (P,) ends of the edges.
        rank: (N,) permutation; 0 is best.

    Returns:
        (N,) the node itself if it leads, else its best-ranked leading neighbour.
    """
    better, worse = np.where(rank[u] < rank[v], (u, v), (v, u))
    # All nodes without an undecided better neighbour are decided at once, so few rounds are needed.
    leads, undecided = np.zeros(len(rank), dtype=bool), np.ones(len(rank), dtype=bool)
    while undecided.any():
        waits = np.zeros_like(undecided)
        waits[worse[undecided[better]]] = True
        leads |= undecided & ~waits
        undecided &= waits
        undecided[worse[leads[better]]] = False
    best = rank.copy()
    absorbed = leads[better]
    np.minimum.at(best, worse[absorbed], rank[better[absorbed]])
    return np.argsort(rank)[best]
