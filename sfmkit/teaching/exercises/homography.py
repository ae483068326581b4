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
        "transfer(H, x1): the pixel (x, y) of image 2 to which the homography H takes the pixel x1 = (x, y) of image 1.",
        _mapped,
        (
            (
                lambda H, x: (H @ np.append(x, 1))[:2],
                "Homogeneous coordinates are not pixels yet: divide by the third.",
            ),
            (
                lambda H, x: _mapped(np.linalg.inv(H), x),
                "That is the way back, from image 2 to image 1.",
            ),
            (
                lambda H, x: (H[:2, :2] @ x + H[:2, 2]) / H[2, 2],
                "The third row counts as well: without it, H would be affine and keep parallels parallel.",
            ),
        ),
        random_inputs(lambda g: (_near_identity(g), g.uniform(0, 640, 2))),
        tolerance=1e-5,
    ),
    "03.2": Exercise(
        "between(H12, H13): the homography from image 2 to image 3 of one plane, given those from image 1 to 2 and from 1 "
        "to 3; any scale.",
        lambda H12, H13: H13 @ np.linalg.inv(H12),
        (
            (
                lambda H12, H13: np.linalg.inv(H12) @ H13,
                "The order: what is done first stands next to the pixel, on the right.",
            ),
            (
                lambda H12, H13: H13 @ H12,
                "H12 leads from image 1 to image 2; you start in image 2, so undo it.",
            ),
            (lambda H12, H13: H12 @ np.linalg.inv(H13), "That leads from image 3 to image 2."),
        ),
        random_inputs(lambda g: (_near_identity(g), _near_identity(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.3": Exercise(
        "turning(K, R): the homography between two photographs from one place, X2 = R X1, with one camera K; any scale.",
        lambda K, R: K @ R @ np.linalg.inv(K),
        (
            (
                lambda K, R: np.linalg.inv(K) @ R @ K,
                "K takes rays to pixels: its inverse stands on the right, where the pixel of image 1 comes in.",
            ),
            (lambda K, R: K @ R.T @ np.linalg.inv(K), "R turns from camera 1 to camera 2 already."),
            (lambda K, R: R, "R turns rays, and pixels are no rays: K is missing on either side."),
        ),
        random_inputs(lambda g: (camera(g), rotation(g))),
        up_to_scale=True,
        tolerance=1e-6,
    ),
    "03.4": Exercise(
        "How many matches at least does a homography take?",
        lambda: 4,
        (
            (lambda: 8, "Eight degrees of freedom, right; but every match gives two equations."),
            (
                lambda: 9,
                "Nine entries, of which the scale says nothing; and every match gives two equations.",
            ),
            (lambda: 3, "Three matches make six equations, enough for an affine map."),
        ),
    ),
}
