"""Notebook 10: robust estimation."""

from __future__ import annotations

from math import ceil, log

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs


def _samples(p: float, w: float, s: int) -> int:
    return ceil(log(1 - p) / log(1 - w**s))


def _distance(line: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.abs(x @ line[:2] + line[2]) / np.hypot(line[0], line[1])


def _sampson(F: np.ndarray, x1: np.ndarray, x2: np.ndarray, images: tuple[int, ...] = (1, 2)):
    y1, y2 = np.append(x1, 1), np.append(x2, 1)
    gradient = [(F.T @ y2)[:2] if image == 1 else (F @ y1)[:2] for image in images]
    return abs(y2 @ F @ y1) / np.linalg.norm(np.concatenate(gradient))


EXERCISES: dict[str, Exercise] = {
    "10.1": Exercise(
        "samples(p, w, s): the smallest whole number of random samples of s matches that contain, "
        "with probability p, at least one sample of inliers only; w is the share of inliers.",
        _samples,
        (
            (
                lambda p, w, s: ceil(log(1 - p) / log(1 - (1 - w) ** s)),
                "w is the share of inliers, not of outliers.",
            ),
            (
                lambda p, w, s: ceil(log(1 - p) / log(1 - w)),
                "All s matches of a sample must be inliers: the probability is w**s.",
            ),
            (
                lambda p, w, s: ceil(log(p) / log(1 - w**s)),
                "1 - p is the probability that every sample contains an outlier.",
            ),
            (
                lambda p, w, s: log(1 - p) / log(1 - w**s),
                "The number of samples is a whole number: round up.",
            ),
        ),
        lambda: ((0.99, 0.5, 2), (0.999, 0.3, 5), (0.9999, 0.6, 7)),
        tolerance=1e-9,
    ),
    "10.2": Exercise(
        "line_through(a, b): the line (A, B, C) with A x + B y + C = 0 through the points a and "
        "b, up "
        "to scale.",
        lambda a, b: np.cross(np.append(a, 1), np.append(b, 1)),
        (
            (
                lambda a, b: np.array([b[0] - a[0], b[1] - a[1], 0.0]),
                "(A, B) is the normal of the line, not its direction, and C is missing.",
            ),
            (
                lambda a, b: np.append(a, 1) + np.append(b, 1),
                "The sum of homogeneous points is a point. The line is their cross product.",
            ),
        ),
        random_inputs(lambda g: tuple(g.uniform(0, 10, (2, 2)))),
        up_to_scale=True,
    ),
    "10.3": Exercise(
        "consensus(l, x, threshold): which of the points x (N, 2) have a distance of at most the "
        "threshold from the line l = (A, B, C)? Return (N,) booleans.",
        lambda l, x, threshold: _distance(l, x) <= threshold,
        (
            (
                lambda l, x, threshold: np.abs(x @ l[:2] + l[2]) <= threshold,
                "A x + B y + C is a distance only if A² + B² = 1. Divide by sqrt(A² + B²).",
            ),
            (
                lambda l, x, threshold: (x @ l[:2] + l[2]) / np.hypot(*l[:2]) <= threshold,
                "Use the absolute value: points on both sides of the line count.",
            ),
            (
                lambda l, x, threshold: _distance(l, x) > threshold,
                "These are the outliers.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=3) * 3, g.normal(size=(200, 2)), 0.5)),
    ),
    "10.4": Exercise(
        "sampson(F, x1, x2): the Sampson distance in pixels (not squared, not negative) between "
        "the "
        "match x1 = (x, y), x2 = (x, y) and the epipolar geometry F.",
        _sampson,
        (
            (
                lambda F, x1, x2: _sampson(F, x1, x2) ** 2,
                "This is the squared distance.",
            ),
            (
                lambda F, x1, x2: abs(np.append(x2, 1) @ F @ np.append(x1, 1)),
                "This is the algebraic error, whose unit depends on the scale of F. Divide by the "
                "norm of its gradient.",
            ),
            (
                lambda F, x1, x2: _sampson(F, x1, x2, (2,)),
                "This is the distance from the epipolar line in image 2. The Sampson distance "
                "permits a displacement in both images.",
            ),
            (
                lambda F, x1, x2: _sampson(F, x1, x2, (1,)),
                "This is the distance from the epipolar line in image 1. The Sampson distance "
                "permits a displacement in both images.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(3, 3)), *g.uniform(0, 3, (2, 2)))),
        tolerance=1e-6,
    ),
}
