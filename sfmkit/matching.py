"""Stage 2: exact nearest neighbours between the descriptors of two images.

Both norms become one matrix product whose largest entry in a row marks the nearest neighbour:

- L2: ``a·b - |a|²/2 - |b|²/2 = -|a - b|²/2``, with the two squared norms appended to the vectors as further columns;
- Hamming: with bits written as ±1, ``a·b = D - 2 h(a, b)`` for ``D`` bits of which ``h`` differ.

The product is formed a few rows at a time, so that a strip of it is reduced (largest of every row, of every column)
while it still lies in the cache. Reading the full product back from memory would cost more than computing it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .errors import InputError
from .types import Features, Matches


@dataclass(frozen=True)
class _Found:
    """What a search over some rows found.

    Attributes:
        best, second: (R,) columns of the highest and second-highest score of every row.
        value: (R,) the highest score.
        leads: (R,) whether it exceeds that of every earlier row in the same column.
        column_best: (width,) the highest score in every column.
    """

    best: Tensor
    second: Tensor
    value: Tensor
    leads: Tensor
    column_best: Tensor


_BLOCK = 128  # columns whose largest score is taken first; the argmax then searches one block in place of a whole row
_STRIP = {"cpu": 1 << 20, "cuda": 1 << 26}  # entries of the product formed at a time: 4 MiB stays in a CPU's cache
_PART = 1024  # rows that one core searches in a go


def match(
    features1: Features,
    features2: Features,
    *,
    mutual: bool = True,
    max_ratio: float | None = None,
    max_distance: float | None = None,
    device: torch.device | str | None = None,
) -> Matches:
    """The nearest neighbour in image 2 of every feature of image 1, by default where the two choose each other.

    The search is exact, and the norm is that of the features. Where both know the sign of the Laplacian, only features of
    equal sign are compared (Bay et al. 2008, section 4.3), and the second-nearest neighbour is one of that sign too.
    Equally near candidates are decided for the lowest row, in both directions, so the result is deterministic. L2 distances
    are ranked in float32: those that differ by less than about 1e-7 of the descriptors' squared length, squared, count
    as equal there; the distances returned are computed afresh from the differences.

    Args:
        features1, features2: N1 and N2 features of one operator in image 1 and image 2.
        mutual: keep a match only if feature 1 is the nearest neighbour of feature 2 as well (cross-check).
        max_ratio: keep a match only if its distance is below this multiple of the distance to the second-nearest
            neighbour (Lowe 2004, section 7.1, proposes 0.8). A sole candidate has no ratio and is dropped.
        max_distance: keep a match only if its distance is at most this (L2, or number of differing bits).
        device: where to compute, e.g. ``"cuda"``; the CPU by default.

    Returns:
        M matches in the order of ``index1``; ``ratio`` is NaN where image 2 offers a single candidate. Memory beyond the
        features grows with N1 + N2, not with their product.

    Raises:
        InputError: when the two cannot be compared, or a limit makes no sense.
    """
    _check_comparable(features1, features2)
    if max_ratio is not None and not 0 < max_ratio <= 1:
        raise InputError(f"max_ratio must lie in (0, 1], for instance 0.8, not {max_ratio}")
    if max_distance is not None and not max_distance >= 0:
        raise InputError(f"max_distance must not be negative: {max_distance}")

    groups = [
        _match_rows(features1.descriptors, features2.descriptors, rows1, rows2, features1.norm, mutual, device)
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
    """Raise InputError unless distances between the two sets of descriptors mean something."""
    for name in ("operator", "norm"):
        a, b = getattr(features1, name), getattr(features2, name)
        if a != b:
            raise InputError(
                f"features of different {name} ('{a}' and '{b}') cannot be matched; detect with one operator"
            )
    w1, w2 = features1.descriptors.shape[1], features2.descriptors.shape[1]
    if w1 != w2 and len(features1) and len(features2):
        raise InputError(
            f"descriptors of {w1} and {w2} columns cannot be matched; give {features1.operator} the same options in both images"
        )


def _comparable_rows(features1: Features, features2: Features) -> list[tuple[np.ndarray, np.ndarray]]:
    """The groups of rows within which features may match: by sign of the Laplacian where both know it, else one."""
    if features1.laplacian is None or features2.laplacian is None:
        return [(np.arange(len(features1)), np.arange(len(features2)))]
    signs = np.union1d(features1.laplacian, features2.laplacian)
    groups = [(np.flatnonzero(features1.laplacian == s), np.flatnonzero(features2.laplacian == s)) for s in signs]
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
    """index1, index2, distance and ratio of the matches between two groups of rows."""
    if not len(rows1) or not len(rows2):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32), np.zeros(0, np.float32)
    a, b = descriptors1[rows1], descriptors2[rows2]
    operands = _l2_operands if norm == "l2" else _hamming_operands
    found = _nearest(*operands(a, b, torch.device(device or "cpu")), mutual)
    i, j, second = (t.cpu().numpy() for t in found)

    measure = _l2_distance if norm == "l2" else _hamming_distance
    distance = measure(a[i], b[j])
    if len(rows2) == 1:
        ratio = np.full(len(i), np.nan, dtype=np.float32)
    else:
        runner_up = measure(a[i], b[second])
        # Two candidates at distance 0 are as ambiguous as can be: ratio 1. Rounding may swap the nearest two: clip.
        ratio = np.divide(distance, runner_up, out=np.ones_like(distance), where=runner_up > 0).clip(max=1)
    return rows1[i], rows2[j], distance, ratio


def _l2_operands(a: np.ndarray, b: np.ndarray, device: torch.device) -> tuple[Tensor, Tensor]:
    """(N1, D + 2) and (N2, D + 2) whose product is -|a - b|²/2."""
    # Distances do not change when both sets are shifted, and shorter vectors lose fewer digits. The shift is a whole
    # number, so that integer descriptors (SIFT) stay integers, whose products are exact.
    centre = np.round(a.mean(axis=0, dtype=np.float64))
    ta, tb = (torch.from_numpy(np.subtract(x, centre, dtype=np.float32)).to(device) for x in (a, b))
    half_a, half_b = (-t.double().square().sum(1, keepdim=True).float() / 2 for t in (ta, tb))
    return torch.cat([ta, half_a, torch.ones_like(half_a)], 1), torch.cat([tb, torch.ones_like(half_b), half_b], 1)


def _hamming_operands(a: np.ndarray, b: np.ndarray, device: torch.device) -> tuple[Tensor, Tensor]:
    """(N1, D) and (N2, D) of ±1, whose product falls by 2 with every bit that differs."""
    dtype = torch.int8 if device.type == "cpu" and _has_fast_int8() else torch.float32
    ta, tb = (torch.from_numpy(np.unpackbits(x, axis=1).astype(np.int8) * 2 - 1) for x in (a, b))
    return ta.to(device, dtype), tb.to(device, dtype)


def _has_fast_int8() -> bool:
    """Whether this CPU multiplies int8 matrices in vector instructions (float32, as exact here, is the slower way)."""
    return torch.backends.mkldnn.is_available() and torch.backends.cpu.get_cpu_capability().startswith("AVX")


def _nearest(a: Tensor, b: Tensor, mutual: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Rows i of `a`, and the rows j and k of `b` with the highest and second-highest scores ``a @ b.T`` in row i.

    With `mutual`, only the rows i that are best in column j. That is recognised by value, since finding where a column's
    largest entry sits costs several times as much as finding how large it is: row i must exceed every earlier row in column
    j, and its score must still be the column's largest in the end.
    """
    n2 = len(b)
    bt = torch.cat([b, b.new_zeros(-n2 % _BLOCK, b.shape[1])]).t()
    parts = _map_on_cores(lambda part: _search(part, bt, n2, mutual), a.split(_PART) if a.device.type == "cpu" else [a])

    best, second, value, leads = (
        torch.cat([getattr(p, name) for p in parts]) for name in ("best", "second", "value", "leads")
    )
    if not mutual:
        return torch.arange(len(a), device=a.device), best, second
    column_best = torch.stack([p.column_best for p in parts])
    part = torch.arange(len(a), device=a.device) // len(parts[0].best)
    earlier = column_best.cummax(0).values.roll(1, 0)
    earlier[0] = _lowest(earlier.dtype)
    row = torch.nonzero(leads & (value > earlier[part, best]) & (value == column_best.amax(0)[best])).flatten()
    return row, best[row], second[row]


def _map_on_cores(function: Callable[[Tensor], _Found], parts: Sequence[Tensor]) -> list[_Found]:
    """`function` of every part, on as many cores as torch may use, each part on one core.

    Parts that never wait for each other also get on when the cores are busy with other work, where torch's own threads,
    which meet after every operation, spend most of the time waiting.
    """
    threads = torch.get_num_threads()
    if threads == 1 or len(parts) == 1:
        return [function(part) for part in parts]
    try:
        with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
            return list(pool.map(function, parts))
    finally:
        torch.set_num_threads(threads)  # a worker's setting is also the default of threads to come


def _search(a: Tensor, bt: Tensor, n2: int, mutual: bool) -> _Found:
    """The two highest scores in every row of ``a @ bt[:, :n2]``, strip by strip."""
    n1, width = len(a), bt.shape[1]
    integer = a.dtype == torch.int8
    product = torch._int_mm if integer else torch.mm
    strip = min(n1, max(16, _STRIP[a.device.type] // width))
    scores = torch.empty((strip, width), dtype=torch.int32 if integer else a.dtype, device=a.device)
    lowest = _lowest(scores.dtype)

    best, second = (torch.empty(n1, dtype=torch.int64, device=a.device) for _ in range(2))
    value = scores.new_empty(n1)
    leads = torch.ones(n1, dtype=torch.bool, device=a.device)
    column_best = scores.new_full((width,), lowest)
    for start in range(0, n1, strip):
        rows = slice(start, min(start + strip, n1))
        s = scores[: rows.stop - start]
        product(a[rows], bt, out=s)
        s[:, n2:] = lowest
        best[rows], second[rows], value[rows] = _two_largest(s.view(len(s), -1, _BLOCK))
        if mutual:
            rivals = s[:, best[rows]]
            first_in_strip = rivals.argmax(0) == torch.arange(len(s), device=a.device)
            leads[rows] = first_in_strip & (value[rows] > column_best[best[rows]])
            torch.maximum(column_best, s.amax(0), out=column_best)
    return _Found(best, second, value, leads, column_best)


def _two_largest(scores: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Columns of the largest and second-largest entry of every row of (R, blocks, block), and the largest entry itself.

    Both lie in the two blocks with the largest maxima, and only those are searched. Of equal entries the first counts.
    """
    r, _, size = scores.shape
    lowest = _lowest(scores.dtype)
    row = torch.arange(r, device=scores.device)[:, None]
    maxima = scores.amax(2)
    block1 = maxima.argmax(1, keepdim=True)
    block2 = maxima.scatter(1, block1, lowest).argmax(1, keepdim=True)
    block = torch.cat([block1, block2], 1)
    finalists = scores[row, block].flatten(1)
    # With a single block both are the same one: its copy must not come second to itself.
    finalists[:, size:].masked_fill_(block1 == block2, lowest)
    place1 = finalists.argmax(1, keepdim=True)
    value = finalists.gather(1, place1)
    place2 = finalists.scatter(1, place1, lowest).argmax(1, keepdim=True)
    column1, column2 = (block.gather(1, p // size) * size + p % size for p in (place1, place2))
    return column1[:, 0], column2[:, 0], value[:, 0]


def _lowest(dtype: torch.dtype) -> float:
    """Less than every score."""
    return -torch.inf if dtype.is_floating_point else torch.iinfo(dtype).min


def _l2_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(M,) distances between corresponding rows."""
    return np.linalg.norm(np.subtract(a, b, dtype=np.float64), axis=1).astype(np.float32)


def _hamming_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(M,) numbers of bits that differ between corresponding rows."""
    return np.bitwise_count(a ^ b).sum(axis=1, dtype=np.int64).astype(np.float32)
