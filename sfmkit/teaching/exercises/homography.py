"""Notebook 03: homographies."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import camera, random_inputs, rotation


def _mapped(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    y = H @ np.append(x, 1)
    return y[:2] / y[2]


def _near_identity(g: np.random.Generator) -> np.ndarray:
    return (
        np.diag([1, 1, 1e-3]) @ (np.eye(3) + 0.3 * g.uniform(-1, 1, (3, 3))) @ np.diag([1, 1, 1e3])
    )


EXERCISES: dict[str, Exercise] = {
    "03.1": Exercise(
        "transfer_by_hand(H, x1): the pixel (x, y) of image 2 to which the homography H maps the "
        "pixel x1 = (x, y) of image 1.",
        _mapped,
        (
            (
                lambda H, x: (H @ np.append(x, 1))[:2],
                "These are homogeneous coordinates. Divide by the third one.",
            ),
            (
                lambda H, x: _mapped(np.linalg.inv(H), x),
                "This maps image 2 to image 1.",
            ),
            (
                lambda H, x: (H[:2, :2] @ x + H[:2, 2]) / H[2, 2],
                "Use the third row as well. Without it, H is affine and preserves parallel lines.",
            ),
        ),
        random_inputs(lambda g: (_near_identity(g), g.uniform(0, 640, 2))),
        tolerance=1e-5,
    ),
    "03.2": Exercise(
        "between(H12, H13): the homography from image 2 to image 3 of a plane, given those from "
        "image "
        "1 to image 2 and from image 1 to image 3, up to scale.",
        lambda H12, H13: H13 @ np.linalg.inv(H12),
        (
            (
                lambda H12, H13: np.linalg.inv(H12) @ H13,
                "The order is wrong: the mapping that is applied first is on the right.",
            ),
            (
                lambda H12, H13: H13 @ H12,
                "H12 maps image 1 to image 2. You start in image 2, so use its inverse.",
            ),
            (lambda H12, H13: H12 @ np.linalg.inv(H13), "This maps image 3 to image 2."),
        ),
        random_inputs(lambda g: (_near_identity(g), _near_identity(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.3": Exercise(
        "turning(K, R): the homography between two photographs taken from the same position, X2 = "
        "R "
        "X1, with the same camera K, up to scale.",
        lambda K, R: K @ R @ np.linalg.inv(K),
        (
            (
                lambda K, R: np.linalg.inv(K) @ R @ K,
                "K maps rays to pixels. Its inverse is on the right, where it is applied to the "
                "pixel of "
                "image 1.",
            ),
            (
                lambda K, R: K @ R.T @ np.linalg.inv(K),
                "R already maps camera 1 to camera 2; do not transpose it.",
            ),
            (lambda K, R: R, "R rotates rays, not pixels: K is missing on both sides."),
        ),
        random_inputs(lambda g: (camera(g), rotation(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.4": Exercise(
        "What is the minimum number of matches that determines a homography?",
        lambda: 4,
        (
            (lambda: 8, "It has eight degrees of freedom, but each match gives two equations."),
            (
                lambda: 9,
                "It has nine entries, but its scale is arbitrary, and each match gives two "
                "equations.",
            ),
            (
                lambda: 3,
                "Three matches give six equations, which determine an affine mapping only.",
            ),
        ),
    ),
}
