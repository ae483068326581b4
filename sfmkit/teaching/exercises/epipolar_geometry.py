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
        "line(F, x1): the epipolar line (a, b, c) in image 2 of the pixel x1 = (x, y) in image 1, any scale.",
        _line,
        (
            (
                lambda F, x: _line(F.T, x),
                "That is the line in image 1 of a pixel of image 2: F itself takes image 1 to image 2.",
            ),
            (
                lambda F, x: F @ np.append(x, 0),
                "The third homogeneous coordinate of a pixel is 1; with 0 it is a direction.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(3, 3)), g.uniform(0, 3, 2))),
        up_to_scale=True,
    ),
    "04.2": Exercise(
        "distance(line, x): how many pixels the pixel x = (x, y) lies from the line a x + b y + c = 0 (not negative).",
        lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l[:2]),
        (
            (
                lambda l, x: abs(l @ np.append(x, 1)),
                "Only with a² + b² = 1 is this a distance: divide by sqrt(a² + b²).",
            ),
            (
                lambda l, x: abs(l @ np.append(x, 1)) / (l[:2] @ l[:2]),
                "Divide by the root of a² + b².",
            ),
            (
                lambda l, x: abs(l @ np.append(x, 1)) / np.linalg.norm(l),
                "c is no part of the normal: divide by sqrt(a² + b²).",
            ),
            (
                lambda l, x: l @ np.append(x, 1) / np.linalg.norm(l[:2]),
                "This is the signed distance; its absolute value is asked for.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=3), g.uniform(-5, 5, 2)), 6),
    ),
    "04.3": Exercise(
        "essential(F, K1, K2): the essential matrix of F, which is for pixels, any scale.",
        lambda F, K1, K2: K2.T @ F @ K1,
        (
            (
                lambda F, K1, K2: K1.T @ F @ K2,
                "F stands between x2 on its left and x1 on its right: so do K2 and K1.",
            ),
            (
                lambda F, K1, K2: np.linalg.inv(K2).T @ F @ np.linalg.inv(K1),
                "The other way about: this makes F from E. Put x = K xn into x2^T F x1 = 0.",
            ),
            (lambda F, K1, K2: K2 @ F @ K1, "x2^T = xn2^T K2^T: the transpose is missing."),
        ),
        random_inputs(lambda g: (g.normal(size=(3, 3)), camera(g), camera(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "04.4": Exercise(
        "How many degrees of freedom has a fundamental matrix?",
        lambda: 7,
        (
            (lambda: 9, "Nine entries, but the scale says nothing and the determinant is zero."),
            (lambda: 8, "Eight are left without the scale; the determinant is zero as well."),
            (
                lambda: 5,
                "Five has the essential matrix: three of the rotation and two of the translation's direction.",
            ),
        ),
    ),
}
