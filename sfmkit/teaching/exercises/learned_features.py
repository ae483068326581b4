"""Notebook 11: learned features."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs


def _softmax(S: np.ndarray, axis: int = -1) -> np.ndarray:
    E = np.exp(S - S.max(axis, keepdims=True))
    return E / E.sum(axis, keepdims=True)


def _attention(Q: np.ndarray, K: np.ndarray, V: np.ndarray) -> np.ndarray:
    return _softmax(Q @ K.T / np.sqrt(Q.shape[1])) @ V


def _assigned(P: np.ndarray, least: float) -> np.ndarray:
    best = P.argmax(1)
    rows = np.arange(len(P))
    keep = (P.argmax(0)[best] == rows) & (P[rows, best] >= least)
    return np.column_stack([rows[keep], best[keep]])


EXERCISES: dict[str, Exercise] = {
    "11.1": Exercise(
        "attention(Q, K, V): the scaled dot-product attention of queries Q (M, d), keys K (N, d) "
        "and values V (N, e), as an (M, e) array.",
        _attention,
        (
            (
                lambda Q, K, V: _softmax(Q @ K.T) @ V,
                "Divide the dot products by sqrt(d); otherwise they grow with the length d.",
            ),
            (
                lambda Q, K, V: _softmax(Q @ K.T / np.sqrt(Q.shape[1]), 0) @ V,
                "The softmax is over the keys: the weights of each query (row) add up to 1.",
            ),
            (
                lambda Q, K, V: Q @ K.T / np.sqrt(Q.shape[1]) @ V,
                "The softmax is missing: the weights must be positive and add up to 1.",
            ),
        ),
        random_inputs(
            lambda g: (g.normal(size=(4, 8)), g.normal(size=(6, 8)), g.normal(size=(6, 3)))
        ),
    ),
    "11.2": Exercise(
        "assigned(P, least): the pairs (i, j), ordered by i, whose score P[i, j] is the largest of "
        "row i and of column j and at least `least`, as an (M, 2) array.",
        _assigned,
        (
            (
                lambda P, least: _assigned(P, -np.inf),
                "Keep only pairs whose score is at least `least`: a keypoint may have no partner.",
            ),
            (
                lambda P, least: np.column_stack(
                    [np.flatnonzero(P.max(1) >= least), P.argmax(1)[P.max(1) >= least]]
                ),
                "The score must also be the largest of its column, or a keypoint of image 2 "
                "gets several partners.",
            ),
            (
                lambda P, least: np.argwhere(least <= P),
                "These are all scores above the limit. Keep the largest of a row and column only.",
            ),
        ),
        random_inputs(lambda g: (g.random((12, 9)), 0.85)),
    ),
    "11.3": Exercise(
        "turned(x, y, h): where the pixel (x, y) of an image of height h is after the image is "
        "rotated clockwise by 90 degrees, as (x', y'). Pixel centres are at whole numbers.",
        lambda x, y, h: np.array([h - 1 - y, x]),
        (
            (
                lambda x, y, h: np.array([h - y, x]),
                "The centres of the first and last row are 0 and h - 1.",
            ),
            (
                lambda x, y, h: np.array([y, h - 1 - x]),
                "This turns the wrong way: the first row becomes the last column.",
            ),
            (
                lambda x, y, h: np.array([y, x]),
                "This is a reflection in the diagonal. The first row becomes the last column.",
            ),
        ),
        random_inputs(lambda g: (*g.integers(0, 300, 2), 384)),
    ),
    "11.4": Exercise(
        "fused_sigma(s): the standard deviation of the best weighted mean of independent "
        "measurements with the standard deviations s (N,).",
        lambda s: 1 / np.sqrt((1 / s**2).sum()),
        (
            (
                lambda s: np.sqrt((s**2).mean() / len(s)),
                "This is the mean with equal weights. The best weights are 1 / s**2.",
            ),
            (
                lambda s: 1 / (1 / s**2).sum(),
                "This is the variance. Take the square root.",
            ),
            (lambda s: s.min(), "The other measurements contain information too."),
        ),
        random_inputs(lambda g: (g.uniform(0.2, 2, 4),)),
    ),
}
