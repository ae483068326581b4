"""Notebook 01: features."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs


def _longest_run(on: np.ndarray, circular: bool = True) -> int:
    best = run = 0
    for v in np.tile(on, 2 if circular else 1):
        run = run + 1 if v else 0
        best = max(best, run)
    return min(best, len(on))


def _fast(ring: np.ndarray, centre: float, threshold: float) -> bool:
    return (
        max(_longest_run(ring > centre + threshold), _longest_run(ring < centre - threshold)) >= 9
    )


def _fast_inputs() -> tuple[tuple[Any, ...], ...]:
    def ring(*bright: int) -> np.ndarray:
        values = np.full(16, 100.0)
        values[list(bright)] = 160
        return values

    wraps = (12, 13, 14, 15, 0, 1, 2, 3, 4)
    dark = 200 - ring(*range(9))
    mixed = ring(*range(5))
    mixed[5:9] = 40
    rings = (
        ring(*range(9)),
        ring(*range(8)),
        ring(*wraps),
        ring(*range(0, 16, 2), 1, 3),
        dark,
        mixed,
        ring(),
    )
    return tuple((values, 100.0, 20.0) for values in rings)


def _orientation(patch: np.ndarray) -> float:
    r = len(patch) // 2
    y, x = np.mgrid[-r : r + 1, -r : r + 1]
    return np.arctan2((y * patch).sum(), (x * patch).sum())


def _box(S: np.ndarray, x0: int, y0: int, x1: int, y1: int) -> float:
    return S[y1, x1] - S[y0, x1] - S[y1, x0] + S[y0, x0]


EXERCISES: dict[str, Exercise] = {
    "01.1": Exercise(
        "is_fast_corner(ring, centre, threshold): are 9 contiguous pixels of the 16 ring pixels "
        "all "
        "brighter than centre + threshold, or all darker than centre - threshold? Pixel 15 is next "
        "to pixel 0.",
        _fast,
        (
            (
                lambda ring, c, t: max((ring > c + t).sum(), (ring < c - t).sum()) >= 9,
                "You count the pixels. The nine pixels must also be contiguous.",
            ),
            (
                lambda ring, c, t: (
                    max(_longest_run(ring > c + t, False), _longest_run(ring < c - t, False)) >= 9
                ),
                "The ring is closed: pixel 15 is a neighbour of pixel 0.",
            ),
            (
                lambda ring, c, t: _longest_run(ring > c + t) >= 9,
                "Dark corners count as well: also test for nine pixels darker than centre - "
                "threshold.",
            ),
            (
                lambda ring, c, t: _longest_run(np.abs(ring - c) > t) >= 9,
                "All nine pixels must be brighter, or all nine must be darker; do not mix them.",
            ),
        ),
        _fast_inputs,
    ),
    "01.2": Exercise(
        "harris(A, k): the corner response det(A) - k trace(A)^2 of the 2 x 2 structure tensor A.",
        lambda A, k: np.linalg.det(A) - k * np.trace(A) ** 2,
        (
            (
                lambda A, k: np.linalg.det(A) - k * np.trace(A),
                "The trace is squared: both terms must have the same units.",
            ),
            (
                lambda A, k: np.linalg.det(A) + k * np.trace(A) ** 2,
                "Subtract the trace term: on an edge, one eigenvalue is large and the response "
                "must be "
                "negative.",
            ),
        ),
        random_inputs(lambda g: ((B := g.normal(size=(2, 2)) * 3) @ B.T, 0.05)),
    ),
    "01.3": Exercise(
        "box_sum(S, x0, y0, x1, y1): the sum of image[y0:y1, x0:x1] from four entries of the "
        "integral image S, where S[y, x] = image[:y, :x].sum().",
        _box,
        (
            (
                lambda S, x0, y0, x1, y1: S[y1, x1] - S[y0, x1] - S[y1, x0],
                "The region up to (x0, y0) is subtracted twice. Add it once.",
            ),
            (
                lambda S, x0, y0, x1, y1: S[y1, x1] - S[y0, x0],
                "With two entries, the sum contains two strips outside the box. Four are needed.",
            ),
        ),
        random_inputs(
            lambda g: (
                np.pad(g.random((12, 15)), ((1, 0), (1, 0))).cumsum(0).cumsum(1),
                3,
                2,
                11,
                9,
            )
        ),
    ),
    "01.4": Exercise(
        "orientation(patch): the angle in radians of the direction from the centre of a square "
        "patch "
        "to its intensity centroid; x to the right, y down, measured from x towards y.",
        _orientation,
        (
            (
                lambda p: np.pi / 2 - _orientation(p),
                "The arguments of arctan2 are (y, x): the moment of y is the first argument.",
            ),
            (
                lambda p: -_orientation(p),
                "y points down in an image: the angle is measured from x towards y, clockwise on "
                "the "
                "screen.",
            ),
            (lambda p: np.degrees(_orientation(p)), "Return radians, not degrees."),
        ),
        random_inputs(lambda g: (g.random((7, 7)) * np.linspace(0.2, 2, 7),)),
        period=2 * np.pi,
    ),
}
