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
        "hamming(a, b): in how many bits do two descriptors of packed bytes (uint8) differ?",
        lambda a, b: int(np.unpackbits(a ^ b).sum()),
        (
            (
                lambda a, b: int((a != b).sum()),
                "You count bytes that differ; each of them holds eight bits.",
            ),
            (
                lambda a, b: int(np.abs(a.astype(int) - b.astype(int)).sum()),
                "The bytes are not numbers to subtract: every bit is an answer of its own. Compare them with ^.",
            ),
        ),
        random_inputs(lambda g: tuple(g.integers(0, 256, (2, 32), dtype=np.uint8))),
    ),
    "02.2": Exercise(
        "mutual(D): the pairs (i, j), ordered by i, that are each other's nearest neighbours in the (N1, N2) distances D, "
        "as an (M, 2) array.",
        _mutual,
        (
            (
                lambda D: np.column_stack([np.arange(len(D)), D.argmin(1)]),
                "These are the nearest neighbours of image 1 alone: keep (i, j) only where i is nearest to j as well.",
            ),
            (lambda D: _mutual(D)[:, ::-1], "The columns are swapped: i, of image 1, comes first."),
        ),
        random_inputs(lambda g: (g.random((9, 7)),)),
    ),
    "02.3": Exercise(
        "ratio(d): for the distances d of one feature to all candidates, the nearest over the second-nearest.",
        lambda d: np.sort(d)[0] / np.sort(d)[1],
        (
            (
                lambda d: np.sort(d)[1] / np.sort(d)[0],
                "Upside down: the ratio lies in [0, 1] and is small for a distinctive match.",
            ),
            (lambda d: d[0] / d[1], "The candidates come in no order: sort the distances first."),
            (
                lambda d: d.min() / d.max(),
                "The rival is the second-nearest candidate, not the farthest.",
            ),
        ),
        random_inputs(lambda g: (g.random(12) + 0.1,)),
    ),
}
