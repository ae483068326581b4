"""Register two overlapping point clouds: iterative closest points (ICP) with scale.

The clouds have different frames and scales and overlap only partially. ICP (Besl & McKay 1992) also
estimates the scale (Zinsser, Schmidt & Niemann 2005). Closest points are paired in both directions,
because with pairs from the moved cloud only, it could shrink to one point of the other cloud.
Mainly distances across the surface are minimised (Chen & Medioni 1992), because a point has no
distinct partner along it. The weight of distant pairs decreases during the iteration, and trimming
(Chetverikov et al. 2005) estimates the overlap of the clouds. Many orientations are tried as
starts, because the signs of the principal axes are arbitrary.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from .._utils.progress import Progress
from ..errors import DegenerateGeometryError, InputError
from ..geometry.similarity import Similarity, fit_similarity
from .density import build_tree

POINTS = 30_000  # largest number of points used per cloud
_COARSE = (600, 15)  # points and steps for every start
_MIDDLE = (4000, 30)  # points and steps for the best starts
_FINE = (POINTS, 60)
_FINALISTS = 8  # number of best starts
_ALONG = 0.1  # weight of distances along the surface; those across it have weight 1
_NORMAL_FROM = 10  # nearest points for the estimate of a normal
_LEAST_OVERLAP = 0.3  # smallest share of the points with a partner
_EXACT = 1e-9  # distance over the size of a cloud below which it is a rounding error
_TRIM_POWER = 3  # balances small distances and a large overlap (1 + lambda of Chetverikov)
_AMBIGUOUS = 0.8  # rivalry from which the result is doubtful


@dataclass(frozen=True, eq=False)
class Alignment:
    """Transformation of the second cloud to the first, and its quality.

    Attributes:
        similarity: Similarity from the frame of the second cloud to that of the first.
        overlap: Shares of the points of the first and of the second cloud with a partner.
        residual: Root mean square distance of these pairs, in the unit of the first cloud.
        rivalry: Score of the result over that of the best start with another result; 0 if all
            starts have this result, 1 if another result is as good, as for a symmetrical object.
    """

    similarity: Similarity
    overlap: tuple[float, float]
    residual: float
    rivalry: float

    @property
    def doubtful(self) -> bool:
        """Whether the result may be wrong.

        Either another result has nearly the same score, or several starts were tried and less than
        half of a cloud has a partner.
        """
        return self.rivalry > _AMBIGUOUS or (self.rivalry > 0 and min(self.overlap) < 0.5)


@dataclass(frozen=True, eq=False)
class _Cloud:
    """A sample of the points of a cloud, in random order, with normals.

    Centre, size and axes of the cloud are robust to a few distant points.
    """

    tree: KDTree
    normals: np.ndarray
    centre: np.ndarray
    size: float
    axes: np.ndarray
    _thinner: dict[int, _Cloud] = field(default_factory=dict)

    @property
    def xyz(self) -> np.ndarray:
        return self.tree.data

    def first(self, n: int) -> _Cloud:
        """Return the first `n` points only."""
        if n not in self._thinner:
            self._thinner[n] = (
                self
                if n >= len(self.xyz)
                else _Cloud(
                    KDTree(self.xyz[:n]), self.normals[:n], self.centre, self.size, self.axes
                )
            )
        return self._thinner[n]


@dataclass(frozen=True, eq=False)
class _State:
    similarity: Similarity
    score: float
    overlap: tuple[float, float]
    residual: float


def align(
    a: np.ndarray,
    b: np.ndarray,
    pairs: np.ndarray | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Alignment:
    """Register the second cloud to the first.

    Args:
        a, b: (N, 3) and (M, 3) points.
        pairs: (P, 2) rows of at least three corresponding points of `a` and `b`, from which the
            iteration starts; without them many orientations of the principal axes are tried.
        seed: Seed of the sample of points.
        progress: Called with (stage, detail).

    Raises:
        InputError: The points or the pairs are invalid.
        DegenerateGeometryError: A cloud has fewer than three distinct points, or lies on a line.
    """
    rng = np.random.default_rng(seed)
    first, second = _cloud(a, "first", rng), _cloud(b, "second", rng)

    def refine(start: Similarity, size: tuple[int, int]) -> _State:
        return _icp(first, second, start, *size)

    if pairs is not None:
        starts = [_from_pairs(np.asarray(a, np.float64), np.asarray(b, np.float64), pairs)]
    else:
        starts = _starts(first, second)
    found = []
    for k, start in enumerate(starts):
        if progress is not None:
            progress("align", f"start {k + 1} of {len(starts)}")
        found.append(refine(start, _COARSE))
    found = _distinct(found, first.size)[:_FINALISTS]
    found = _distinct([refine(state.similarity, _MIDDLE) for state in found], first.size)
    if progress is not None:
        progress("align", "best start")
    best = refine(found[0].similarity, _FINE)
    rivalry = found[0].score / found[1].score if len(found) > 1 else 0.0
    return Alignment(best.similarity, best.overlap, best.residual, rivalry)


def _cloud(xyz: np.ndarray, which: str, rng: np.random.Generator) -> _Cloud:
    xyz = build_tree(xyz).data
    xyz = xyz[rng.permutation(len(xyz))[:POINTS]]
    spread = np.linalg.svd((xyz - xyz.mean(0))[:1000], compute_uv=False)
    if len(xyz) < 3 or spread[1] <= 1e-9 * spread[0]:
        raise DegenerateGeometryError(
            f"the {which} cloud's points lie on a line or at one place, "
            "so its orientation is undetermined",
            points=len(xyz),
        )
    centre = np.median(xyz, axis=0)
    distance = np.linalg.norm(xyz - centre, axis=1)
    size = float(np.median(distance)) or float(distance.max())
    inner = xyz[distance <= 3 * size] - centre
    with np.errstate(over="ignore", invalid="ignore"):
        moments = inner.T @ inner
    if not np.isfinite(moments).all() or size == 0 or not moments.any():
        raise InputError(f"the {which} cloud's extent is too large or too small to be squared")
    axes = np.linalg.eigh(moments)[1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    tree = KDTree(xyz)
    near = xyz[tree.query(xyz, k=min(_NORMAL_FROM, len(xyz)), workers=-1)[1]]
    near = near - near.mean(1, keepdims=True)
    return _Cloud(tree, np.linalg.eigh(near.mT @ near)[1][:, :, 0], centre, size, axes)


def _starts(a: _Cloud, b: _Cloud) -> list[Similarity]:
    """Compute similarities that align centre, size and principal axes, in 84 orientations.

    Every orientation is within about 40 degrees of a rotation of the octahedron (24, permutations
    of the axes included) or of the icosahedron (60).
    """
    turns = Rotation.concatenate(
        [Rotation.create_group("O"), Rotation.create_group("I")]
    ).as_matrix()
    scale = a.size / b.size
    starts = []
    for turn in turns:
        R = a.axes @ turn @ b.axes.T
        starts.append(_similarity(scale, R, a.centre - scale * R @ b.centre))
    return starts


def _similarity(s: float, R: np.ndarray, t: np.ndarray) -> Similarity:
    return Similarity(
        torch.tensor(float(s), dtype=torch.float64),
        torch.from_numpy(R.copy()),
        torch.from_numpy(t.copy()),
    )


def _from_pairs(a: np.ndarray, b: np.ndarray, pairs: np.ndarray) -> Similarity:
    pairs = np.asarray(pairs)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise InputError(
            "pairs must be whole numbers of shape (P, 2), rows of the two clouds, not "
            f"{pairs.shape}"
        )
    for column, cloud, which in ((0, a, "first"), (1, b, "second")):
        if len(pairs) and (pairs[:, column].min() < 0 or pairs[:, column].max() >= len(cloud)):
            raise InputError(
                f"pairs name points that the {which} cloud of {len(cloud):,} does not have"
            )
    return fit_similarity(torch.from_numpy(b[pairs[:, 1]]), torch.from_numpy(a[pairs[:, 0]]))


def _icp(a: _Cloud, b: _Cloud, start: Similarity, points: int, steps: int) -> _State:
    """Iterate closest points, in both directions, from `start`."""
    now, a, b = start, a.first(points), b.first(points)
    for _ in range(steps):
        moved, to_a, row_a, to_b, row_b = _closest(a, b, now)
        x = np.concatenate([moved, now.apply(torch.from_numpy(b.xyz[row_b])).numpy()])
        y = np.concatenate([a.xyz[row_a], a.xyz])
        normal = np.concatenate([a.normals[row_a], b.normals[row_b] @ now.R.numpy().T])
        distance = np.concatenate([to_a, to_b])
        limit = 3 * np.quantile(distance, _LEAST_OVERLAP) + _EXACT * a.size
        weight = (1 + (distance / limit) ** 2) ** -2  # Geman & McClure 1985
        # Points beyond the border of the other cloud are all paired with points on the border;
        # together they have the weight of one pair.
        weight /= np.concatenate([np.bincount(row)[row] for row in (row_a, row_b)])
        step = _gauss_newton(x, y, normal, weight)
        further = Similarity(step.s * now.s, step.R @ now.R, step.s * (step.R @ now.t) + step.t)
        if not 1 / 3 < float(further.s / start.s) < 3:
            break  # the scale diverges
        now = further
        change = step.apply(torch.from_numpy(moved)).numpy() - moved
        if np.abs(change).max() < (_EXACT if points == POINTS else 1e-4) * a.size:
            break
    _, to_a, _, to_b, _ = _closest(a, b, now)
    (near_a, share_a), (near_b, share_b) = (
        _trim(to_b, _EXACT * a.size),
        _trim(to_a, _EXACT * a.size),
    )
    residual = float(np.sqrt(np.concatenate([near_a, near_b]).mean()))
    return _State(
        now, _score(near_a, share_a) + _score(near_b, share_b), (share_a, share_b), residual
    )


def _closest(a: _Cloud, b: _Cloud, now: Similarity) -> tuple:
    """Move the second cloud, and find the closest points in both directions.

    Returns:
        The moved cloud, and for both clouds the distances to the partners (in the unit of the first
        cloud) and the rows of the partners.
    """
    moved = now.apply(torch.from_numpy(b.xyz)).numpy()
    workers = -1 if len(a.xyz) > 5000 else 1  # threads are slower for few points
    to_a, row_a = a.tree.query(moved, workers=workers)
    to_b, row_b = b.tree.query(
        now.inverse().apply(torch.from_numpy(a.xyz)).numpy(), workers=workers
    )
    return moved, to_a, row_a, to_b * float(now.s), row_b


def _gauss_newton(
    x: np.ndarray, y: np.ndarray, normal: np.ndarray, weight: np.ndarray
) -> Similarity:
    """Compute one Gauss-Newton step: a small similarity that moves `x` towards `y`.

    Distances across the surfaces have a larger weight than distances along them.
    """
    centre = np.average(x, axis=0, weights=weight)
    p, r = x - centre, y - x
    size = np.sqrt(
        np.average((p**2).sum(1), weights=weight)
    )  # scales the unknowns to similar magnitudes
    p = p / size
    # derivative of a similarity: a point p moves by turn x p + shift + growth p
    J = np.zeros((len(p), 3, 7))
    J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = p[:, 2], -p[:, 1], p[:, 0]
    J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = -p[:, 2], p[:, 1], -p[:, 0]
    J[:, :, 3:6] = np.eye(3)
    J[:, :, 6] = p
    across = (normal[:, None] @ J)[:, 0]
    A = (across * weight[:, None]).T @ across + _ALONG**2 * np.einsum(
        "n,nij,nik->jk", weight, J, J, optimize=True
    )
    g = across.T @ (weight * (normal * r).sum(1)) + _ALONG**2 * np.einsum(
        "n,nij,ni->j", weight, J, r, optimize=True
    )
    # The minimum-norm solution, if the points do not determine all unknowns.
    step, *_ = np.linalg.lstsq(A, g, rcond=None)
    turn, shift, growth = np.split(step, (3, 6))
    R = Rotation.from_rotvec(turn / size).as_matrix()
    s = float(np.exp(growth[0] / size))
    return _similarity(s, R, shift + centre - s * R @ centre)


def _trim(distance: np.ndarray, exact: float) -> tuple[np.ndarray, float]:
    """Return the squared distances of the points with a partner, and their share.

    The share minimises the mean squared distance over share ** 3; `exact` counts as zero.
    """
    squared = np.sort(distance**2) + exact**2
    count = np.arange(1, len(squared) + 1)
    cost = np.cumsum(squared) / count / (count / len(squared)) ** _TRIM_POWER
    least = int(np.ceil(_LEAST_OVERLAP * len(squared))) - 1
    keep = len(cost) - int(np.argmin(cost[least:][::-1]))  # the largest of equal shares
    return squared[:keep], keep / len(squared)


def _score(squared: np.ndarray, share: float) -> float:
    return float(np.sqrt(squared.mean() / share**_TRIM_POWER))


def _distinct(states: list[_State], size: float) -> list[_State]:
    """Return the states, best first, without those within 10 degrees and 10 % of a better one."""
    kept: list[_State] = []
    for state in sorted(states, key=lambda s: s.score):
        if all(_apart(state.similarity, other.similarity) for other in kept):
            kept.append(state)
    return kept


def _apart(one: Similarity, other: Similarity) -> bool:
    cosine = (float((one.R * other.R).sum()) - 1) / 2
    return cosine < np.cos(np.deg2rad(10)) or abs(np.log(float(one.s / other.s))) > 0.1
