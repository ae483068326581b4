"""Notebook 02: matching."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs


def _mutual(D: np.ndarray) -> np.ndarray:
    nearest = D.argmin(1)
    rows = np.flatnonzero(D.argmin(0)[nearest] == np.arange(len(D)))
    return np.column_stack([rows, nearest[rows]])


EXERCISES: dict[str, Exercise] = {
    "02.1": Exercise(
        "hamming(a, b): the number of bits in which two descriptors of packed bytes (uint8) "
        "differ.",
        lambda a, b: int(np.unpackbits(a ^ b).sum()),
        (
            (
                lambda a, b: int((a != b).sum()),
                "You count the bytes that differ. Each byte contains eight bits.",
            ),
            (
                lambda a, b: int(np.abs(a.astype(int) - b.astype(int)).sum()),
                "Do not subtract the bytes as numbers: each bit is a separate comparison. Use ^.",
            ),
        ),
        random_inputs(lambda g: tuple(g.integers(0, 256, (2, 32), dtype=np.uint8))),
    ),
    "02.2": Exercise(
        "mutual_pairs(D): the pairs (i, j), ordered by i, of mutual nearest neighbours for the "
        "(N1, "
        "N2) distance matrix D, as an (M, 2) array.",
        _mutual,
        (
            (
                lambda D: np.column_stack([np.arange(len(D)), D.argmin(1)]),
                "These are the nearest neighbours of the features of image 1. Keep (i, j) only if "
                "i is "
                "also the nearest neighbour of j.",
            ),
            (lambda D: _mutual(D)[:, ::-1], "The columns are swapped: i, of image 1, is first."),
        ),
        random_inputs(lambda g: (g.random((9, 7)),)),
    ),
    "02.3": Exercise(
        "ratio(d): the nearest divided by the second-nearest distance, for the distances d of one "
        "feature to all candidates.",
        lambda d: np.sort(d)[0] / np.sort(d)[1],
        (
            (
                lambda d: np.sort(d)[1] / np.sort(d)[0],
                "This is the inverse. The ratio lies in [0, 1] and is small for a distinctive "
                "match.",
            ),
            (lambda d: d[0] / d[1], "The candidates are not sorted. Sort the distances first."),
            (
                lambda d: d.min() / d.max(),
                "Divide by the second-nearest distance, not by the largest one.",
            ),
        ),
        random_inputs(lambda g: (g.random(12) + 0.1,)),
    ),
}
