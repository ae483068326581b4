"""Exact nearest neighbours between the descriptors of two images.

Both norms reduce to a matrix product whose largest entry in a row belongs to the nearest neighbour:

- L2: ``a·b - |a|²/2 - |b|²/2 = -|a - b|²/2``, with the two squared norms appended to the vectors
  as columns;
- Hamming: ``a·b = D - 2 h(a, b)`` for ``D`` bits written as ±1, of which ``h`` differ.

The product is computed in strips of a few rows. Each strip is reduced (largest entry per row and
per column) while it is still in the cache; reading the full product back from memory would take
longer than computing it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from .._utils.parallel import map_on_cores
from ..errors import InputError
from ..types import Features, Matches

# columns per block: the maximum of every block is found first, then the argmax within one block
_BLOCK = 128
# number of entries of the product that are computed at a time: 5 MiB stay in a CPU's cache
_STRIP = {"cpu": 5 << 18, "cuda": 1 << 26}
_PART = 1024  # minimum number of rows that one core searches at a time
_MANY = 64  # maximum number of candidates within rounding of the nearest that are compared exactly


def match(
    features1: Features,
    features2: Features,
    *,
    mutual: bool = True,
    max_ratio: float | None = None,
    max_distance: float | None = None,
    device: torch.device | str | None = None,
) -> Matches:
    """Match every feature of image 1 to its nearest neighbour in image 2, mutual by default.

    The search is exact, and the norm is that of the features. If both have the sign of the
    Laplacian, only features of equal sign are compared (Bay et al. 2008, section 4.3), and the
    second-nearest neighbour has that sign too. Among equally near candidates, the lowest row is
    chosen in both directions, so the result is deterministic. Comparisons within the rounding of
    float32 are repeated in float64. On CUDA, torch's float32 matrix products must not be set to a
    lower precision (TF32) than torch's own default.

    Args:
        features1, features2: N1 and N2 features of one operator in image 1 and image 2.
        mutual: Keep a match only if feature 1 is the nearest neighbour of feature 2 as well
            (cross-check).
        max_ratio: Keep a match only if its distance is below this multiple of the distance to the
            second-nearest neighbour (Lowe 2004, section 7.1, proposes 0.8). A single candidate has
            no ratio and is dropped.
        max_distance: Keep a match only if its distance is at most this (L2, or number of differing
            bits).
        device: Torch device, e.g. ``"cuda"``; the CPU by default.

    Returns:
        M matches in the order of ``index1``; ``ratio`` is NaN if image 2 has a single candidate.
        Memory beyond the features grows with N1 + N2, not with their product.

    Raises:
        InputError: The features are not comparable, or a limit is invalid.
    """
    _check_comparable(features1, features2)
    if max_ratio is not None and not 0 < max_ratio <= 1:
        raise InputError(f"max_ratio must lie in (0, 1], for instance 0.8, not {max_ratio}")
    if max_distance is not None and not max_distance >= 0:
        raise InputError(f"max_distance must not be negative: {max_distance}")

    groups = [
        _match_rows(
            features1.descriptors,
            features2.descriptors,
            rows1,
            rows2,
            features1.norm,
            mutual,
            device,
        )
        for rows1, rows2 in _comparable_rows(features1, features2)
    ]
    index1, index2, distance, ratio = (np.concatenate(column) for column in zip(*groups))
    keep = np.ones(len(index1), dtype=bool)
    if max_ratio is not None:
        keep &= ratio < max_ratio
    if max_distance is not None:
        keep &= distance <= max_distance
    order = np.argsort(index1, kind="stable")
    order = order[keep[order]]
    return Matches(index1[order], index2[order], distance[order], ratio[order])


def _check_comparable(features1: Features, features2: Features) -> None:
    """Raise InputError if the descriptors of the two images are not comparable."""
    for name in ("operator", "norm"):
        a, b = getattr(features1, name), getattr(features2, name)
        if a != b:
            raise InputError(
                f"features of different {name} ('{a}' and '{b}') cannot be matched; detect with "
                "one operator"
            )
    w1, w2 = features1.descriptors.shape[1], features2.descriptors.shape[1]
    if w1 != w2 and len(features1) and len(features2):
        raise InputError(
            f"descriptors of {w1} and {w2} columns cannot be matched; use the same options of "
            f"{features1.operator} in both images"
        )


def _comparable_rows(
    features1: Features, features2: Features
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return groups of rows that may match.

    There is one group per sign of the Laplacian if both have it, and a single group otherwise.
    """
    if features1.laplacian is None or features2.laplacian is None:
        return [(np.arange(len(features1)), np.arange(len(features2)))]
    signs = np.union1d(features1.laplacian, features2.laplacian)
    groups = [
        (np.flatnonzero(features1.laplacian == s), np.flatnonzero(features2.laplacian == s))
        for s in signs
    ]
    return groups or [(np.arange(0), np.arange(0))]


def _match_rows(
    descriptors1: np.ndarray,
    descriptors2: np.ndarray,
    rows1: np.ndarray,
    rows2: np.ndarray,
    norm: str,
    mutual: bool,
    device: torch.device | str | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Match two groups of rows; return index1, index2, distance and ratio."""
    if not len(rows1) or not len(rows2):
        return (
            np.zeros(0, np.int64),
            np.zeros(0, np.int64),
            np.zeros(0, np.float32),
            np.zeros(0, np.float32),
        )
    a, b = descriptors1[rows1], descriptors2[rows2]
    vectors = _l2_vectors if norm == "l2" else _hamming_vectors
    measure = _l2_distance if norm == "l2" else _hamming_distance
    i, j, second = _nearest(
        *vectors(a, b, torch.device(device or "cpu")), mutual, lambda i, j: measure(a[i], b[j])
    )

    distance = measure(a[i], b[j])
    if len(rows2) == 1:
        ratio = np.full(len(i), np.nan)
    else:
        # Two candidates at distance 0 cannot be distinguished: ratio 1.
        runner_up = measure(a[i], b[second])
        ratio = np.divide(distance, runner_up, out=np.ones(len(i)), where=runner_up > 0)
    return rows1[i], rows2[j], distance.astype(np.float32), ratio.astype(np.float32)


def _l2_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute L2 distances (M,) between corresponding rows."""
    return np.linalg.norm(np.subtract(a, b, dtype=np.float64), axis=1)


def _hamming_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Count differing bits (M,) between corresponding rows."""
    return np.bitwise_count(a ^ b).sum(axis=1, dtype=np.float64)


def _l2_vectors(a: np.ndarray, b: np.ndarray, device: torch.device) -> tuple[Tensor, Tensor, float]:
    """Build (N1, D + 2) and (N2, D + 2) vectors whose product is -|a - b|²/2.

    Also returns a bound of the rounding error of a comparison of two such products.
    """
    # Distances do not change if both sets are shifted, and shorter vectors lose fewer digits. The
    # shift is a whole number, so integer descriptors (SIFT) stay integers, whose products are
    # exact.
    centre = np.round(b.mean(axis=0, dtype=np.float64))
    a, b = (np.subtract(x, centre, dtype=np.float32) for x in (a, b))
    longest = max(float(np.square(x, dtype=np.float64).sum(1).max()) for x in (a, b))
    exact = longest < 2**22 and all((x == np.rint(x)).all() for x in (a, b))
    terms = a.shape[1] + 2
    # The error of each sum of products is at most `terms` roundings of its terms' magnitudes, here
    # |a||b| + |a|²/2 + |b|²/2 (Higham 2002, section 3.1); a comparison involves two of them.
    tolerance = 0.0 if exact else 2 * terms * 2.0**-24 * 2 * longest
    ta, tb = (torch.from_numpy(x).to(device) for x in (a, b))
    half_a, half_b = (-t.double().square().sum(1, keepdim=True).float() / 2 for t in (ta, tb))
    ones_a, ones_b = torch.ones_like(half_a), torch.ones_like(half_b)
    return torch.cat([ta, half_a, ones_a], 1), torch.cat([tb, ones_b, half_b], 1), tolerance


def _hamming_vectors(
    a: np.ndarray, b: np.ndarray, device: torch.device
) -> tuple[Tensor, Tensor, float]:
    """Build (N1, D) and (N2, D) vectors of ±1.

    Their product decreases by 2 with every differing bit and is exact.
    """
    dtype = _fastest_sign_dtype() if device.type == "cpu" else torch.float32
    ta, tb = (torch.from_numpy(np.unpackbits(x, axis=1).astype(np.int8) * 2 - 1) for x in (a, b))
    return ta.to(device, dtype), tb.to(device, dtype), 0.0


@cache
def _fastest_sign_dtype() -> torch.dtype:
    """Choose the dtype in which this processor multiplies matrices of ±1 faster.

    int8 and float32 are both exact, so the choice never changes a result. The speed is measured,
    because torch's int8 product is several times faster with VNNI instructions and 20 times slower
    without them (torch 2.15, AVX2), and torch has no public query for them.
    """
    a, b = torch.ones((32, 256), dtype=torch.int8), torch.ones((2048, 256), dtype=torch.int8)
    seconds = {}
    for dtype in (torch.float32, torch.int8):
        x, y = a.to(dtype), b.to(dtype)
        out = torch.empty((32, 2048), dtype=torch.int32 if dtype == torch.int8 else dtype)
        _product(x, y, out)
        times = []
        for _ in range(3):
            began = time.perf_counter()
            _product(x, y, out)
            times.append(time.perf_counter() - began)
        seconds[dtype] = min(times)
    return min(seconds, key=lambda dtype: seconds[dtype])


def _has_onednn(instructions: str) -> bool:
    """Return whether torch has oneDNN and the processor has these vector instructions."""
    return (
        torch.backends.mkldnn.is_available()
        and torch.backends.cpu.get_cpu_capability().startswith(instructions)
    )


# distances of rows i of image 1 and rows j of image 2
Distance = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _nearest(
    a: Tensor, b: Tensor, tolerance: float, mutual: bool, distance: Distance
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the rows j and k of `b` with the two highest scores for every row i of `a`.

    The scores are ``a @ b.T``. With `mutual`, only the rows i that are best in column j are
    returned. This is decided from the values of the two largest entries of the column, because
    finding their positions takes several times as long. Scores that differ by at most `tolerance`
    are searched again and compared by `distance`.
    """
    n2 = len(b)
    padded = torch.cat([b, b.new_zeros(-n2 % _BLOCK, b.shape[1])])
    size = max(_PART, -(-len(a) // (4 * torch.get_num_threads()))) if a.is_cpu else len(a)
    parts = map_on_cores(lambda part: _search(part, padded, n2, mutual), a.split(size))
    best, second, value, second_value, rival = (
        torch.cat([getattr(p, name) for p in parts])
        for name in ("best", "second", "value", "second_value", "rival")
    )
    if tolerance:
        open_rows = torch.nonzero(second_value >= value - tolerance).flatten()
        i = open_rows.cpu().numpy()
        found, next_to_it = _search_exactly(
            a[open_rows], b, tolerance, lambda u, j: distance(i[u], j)
        )
        other = torch.where(found == best[open_rows], second[open_rows], best[open_rows])
        best[open_rows], second[open_rows] = found, torch.where(next_to_it < 0, other, next_to_it)
    rows = torch.arange(len(a), device=a.device)
    if mutual:
        first, runner_up = torch.cat([p.column_best for p in parts]).topk(2, dim=0).values
        rival = torch.maximum(
            rival, torch.where(value == first[best], runner_up[best], first[best])
        )
        leads = value > rival + tolerance
        doubt = torch.nonzero((value >= rival - tolerance) & ~leads).flatten()
        columns, of = best[doubt].unique(return_inverse=True)
        j = columns.cpu().numpy()
        found, _ = _search_exactly(b[columns], a, tolerance, lambda v, i: distance(i, j[v]))
        leads[doubt] = found[of] == doubt
        rows = rows[leads]
    i, j, k = (t.cpu().numpy() for t in (rows, best[rows], second[rows]))
    return i, j, k


@dataclass(frozen=True)
class _Found:
    """The result of a search over some rows.

    Attributes:
        best, second: (R,) columns of the highest and second-highest score of every row.
        value, second_value: (R,) these two scores.
        rival: (R,) highest score of the other rows of the same strip in the column `best`.
        column_best: (2, width) largest and second-largest of the highest scores of the strips in
            every column.
    """

    best: Tensor
    second: Tensor
    value: Tensor
    second_value: Tensor
    rival: Tensor
    column_best: Tensor


def _search(a: Tensor, b: Tensor, n2: int, mutual: bool) -> _Found:
    """Find the two highest scores in every row of ``a @ b[:n2].T``.

    With `mutual`, the highest scores of every column are found too. The product is computed in
    strips.
    """
    strip = _strip(a, b)
    out = torch.empty(
        (strip, len(b)), dtype=torch.int32 if a.dtype == torch.int8 else a.dtype, device=a.device
    )
    lowest = _lowest(out.dtype)
    best, second = (torch.empty(len(a), dtype=torch.int64, device=a.device) for _ in range(2))
    value, second_value, rival = (out.new_full((len(a),), lowest) for _ in range(3))
    first, runner_up = column_best = out.new_full((2, len(b)), lowest)
    for start in range(0, len(a), strip):
        rows = slice(start, min(start + strip, len(a)))
        s = _product(a[rows], b, out[: rows.stop - start])
        s[:, n2:] = lowest
        best[rows], second[rows], value[rows], second_value[rows] = _two_largest(
            s.view(len(s), -1, _BLOCK)
        )
        if mutual:
            rival[rows] = s[:, best[rows]].fill_diagonal_(lowest).amax(0)
            highest = s.amax(0)
            torch.maximum(runner_up, torch.minimum(first, highest), out=runner_up)
            torch.maximum(first, highest, out=first)
    return _Found(best, second, value, second_value, rival, column_best)


def _search_exactly(
    a: Tensor, b: Tensor, tolerance: float, distance: Distance
) -> tuple[Tensor, Tensor]:
    """Find the rows (R,) of `b` nearest and second-nearest to every row of `a` by `distance`.

    Among equally near rows, the lowest is chosen. Only rows whose score is within `tolerance` of
    the highest are compared. If there are many of them, nearly all descriptors are equal, and the
    rows are regarded as equally near. The second row is -1 if it is not among the compared rows.
    """
    strip, dtype = _strip(a, b), torch.int32 if a.dtype == torch.int8 else a.dtype
    nearest, second = (a.new_full((len(a),), -1, dtype=torch.int64) for _ in range(2))
    for start in range(0, len(a), strip):
        part = a[start : start + strip]
        s = _product(part, b, part.new_empty((len(part), len(b)), dtype=dtype))
        near = s >= s.amax(1, keepdim=True) - tolerance
        nearest[start : start + strip] = near.byte().argmax(1)
        if tolerance:
            near &= near.sum(1, keepdim=True) <= _MANY
            u, j = (t.cpu().numpy() for t in torch.nonzero(near, as_tuple=True))
            order = np.lexsort((j, distance(start + u, j), u))
            row, column = (torch.from_numpy(t[order]).to(a.device) for t in (start + u, j))
            rank = torch.arange(len(row), device=a.device) - torch.searchsorted(row, row)
            nearest[row[rank == 0]] = column[rank == 0]
            second[row[rank == 1]] = column[rank == 1]
    return nearest, second


def _strip(a: Tensor, b: Tensor) -> int:
    """Compute how many rows of `a` to multiply with `b` at a time."""
    return max(1, min(len(a), max(32, _STRIP[a.device.type] // len(b) // 32 * 32)))


def _product(a: Tensor, b: Tensor, out: Tensor) -> Tensor:
    """Compute ``a @ b.T``.

    The result is `out` or, if the fastest function has no such parameter, a new tensor.
    """
    if a.dtype == torch.int8:
        return torch._int_mm(a, b.t(), out=out)
    if a.is_cpu and _has_onednn("AVX512"):
        # torch.mm calls MKL, which does not use AVX-512 on processors of other manufacturers and
        # then takes twice as long.
        return torch.ops.mkldnn._linear_pointwise(a, b, None, "none", [], "")
    return torch.mm(a, b.t(), out=out)


def _two_largest(scores: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Find the two largest entries of every row of (R, blocks, block).

    Both lie in the two blocks with the largest maxima, and only these are searched. Among equal
    entries, the first is chosen. Returns the two columns, then the two values.
    """
    r, _, size = scores.shape
    lowest = _lowest(scores.dtype)
    maxima = scores.amax(2)
    block1 = maxima.argmax(1, keepdim=True)
    block2 = maxima.scatter(1, block1, lowest).argmax(1, keepdim=True)
    block = torch.cat([block1, block2], 1)
    finalists = scores[torch.arange(r, device=scores.device)[:, None], block]
    # With a single block, both are the same, and its copy must not become the second.
    finalists[:, 1].masked_fill_(block1 == block2, lowest)
    finalists = finalists.flatten(1)
    place1 = finalists.argmax(1, keepdim=True)
    value1 = finalists.gather(1, place1)
    place2 = finalists.scatter_(1, place1, lowest).argmax(1, keepdim=True)
    value2 = finalists.gather(1, place2)
    column1, column2 = (block.gather(1, p // size) * size + p % size for p in (place1, place2))
    return column1[:, 0], column2[:, 0], value1[:, 0], value2[:, 0]


def _lowest(dtype: torch.dtype) -> float:
    """Return a value below every score."""
    return -torch.inf if dtype.is_floating_point else torch.iinfo(dtype).min
