"""Notebook 04: epipolar geometry."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import camera, random_inputs


def _line(F: np.ndarray, x: np.ndarray) -> np.ndarray:
    line = F @ np.append(x, 1)
    return line / np.linalg.norm(line[:2])


EXERCISES: dict[str, Exercise] = {
    "04.1": Exercise(
        "line(F, x1): the epipolar line (a, b, c) in image 2 of the pixel x1 = (x, y) of image 1, "
        "up "
        "to scale.",
        _line,
        (
            (
                lambda F, x: _line(F.T, x),
                "This is the line in image 1 of a pixel of image 2. F itself maps pixels of image "
                "1 to "
                "lines of image 2.",
            ),
            (
                lambda F, x: F @ np.append(x, 0),
                "The third homogeneous coordinate of a pixel is 1. With 0 it is a direction.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(3, 3)), g.uniform(0, 3, 2))),
        up_to_scale=True,
    ),
    "04.2": Exercise(
        "distance(l, x): the distance in pixels between the pixel x = (x, y) and the line l = (a, "
        "b, "
        "c) with a x + b y + c = 0, not negative.",
        lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l[:2]),
        (
            (
                lambda l, x: abs(l @ np.append(x, 1)),
                "This is a distance only if a² + b² = 1. Divide by sqrt(a² + b²).",
            ),
            (
                lambda l, x: abs(l @ np.append(x, 1)) / (l[:2] @ l[:2]),
                "Divide by the square root of a² + b².",
            ),
            (
                lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l),
                "c does not belong to the normal. Divide by sqrt(a² + b²).",
            ),
            (
                lambda l, x: l @ np.append(x, 1) / np.linalg.norm(l[:2]),
                "This is the signed distance. Return its absolute value.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=3), g.uniform(-5, 5, 2)), 6),
    ),
    "04.3": Exercise(
        "essential(F, K1, K2): the essential matrix for the fundamental matrix F, up to scale.",
        lambda F, K1, K2: K2.T @ F @ K1,
        (
            (
                lambda F, K1, K2: K1.T @ F @ K2,
                "F is multiplied by x2 from the left and by x1 from the right; the same holds for "
                "K2 and "
                "K1.",
            ),
            (
                lambda F, K1, K2: np.linalg.inv(K2).T @ F @ np.linalg.inv(K1),
                "This converts E to F. Insert x = K xn into x2^T F x1 = 0.",
            ),
            (lambda F, K1, K2: K2 @ F @ K1, "x2^T = xn2^T K2^T: the transpose is missing."),
        ),
        random_inputs(lambda g: (g.normal(size=(3, 3)), camera(g), camera(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "04.4": Exercise(
        "How many degrees of freedom does a fundamental matrix have?",
        lambda: 7,
        (
            (
                lambda: 9,
                "It has nine entries, but its scale is arbitrary and its determinant is zero.",
            ),
            (lambda: 8, "Eight remain without the scale, but the determinant is zero as well."),
            (
                lambda: 5,
                "The essential matrix has five: three of the rotation and two of the direction of "
                "the "
                "translation.",
            ),
        ),
    ),
}
