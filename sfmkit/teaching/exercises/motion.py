"""Notebook 05: motion."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import hat, random_inputs, rotation, unit


def _in_front(X: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    return (X[:, 2] > 0) & ((X @ R.T + t)[:, 2] > 0)


_POSE = random_inputs(lambda g: (rotation(g), unit(g.normal(size=3))))

EXERCISES: dict[str, Exercise] = {
    "05.1": Exercise(
        "centre(R, t): where camera 2 stands, in the frame of camera 1, given X2 = R X1 + t.",
        lambda R, t: -R.T @ t,
        (
            (
                lambda R, t: t,
                "t is where camera 1 stands in the frame of camera 2: put X1 = 0 in. Solve R X1 + t = 0.",
            ),
            (
                lambda R, t: -t,
                "-t is a direction in the axes of camera 2; turn it back into those of camera 1.",
            ),
            (lambda R, t: R.T @ t, "The sign: the centre is the X1 with R X1 + t = 0."),
            (lambda R, t: -R @ t, "Undo the rotation with its transpose."),
        ),
        _POSE,
    ),
    "05.2": Exercise(
        "essential(R, t): the essential matrix of the motion X2 = R X1 + t, any scale.",
        lambda R, t: hat(t) @ R,
        (
            (
                lambda R, t: R @ hat(t),
                "The order: X2 = R X1 + t is crossed with t from the left, E = [t]x R.",
            ),
            (
                lambda R, t: hat(t) @ R.T,
                "R turns from camera 1 to camera 2 already; it needs no transpose.",
            ),
            (lambda R, t: hat(t), "That is E of a motion without rotation."),
        ),
        _POSE,
        up_to_scale=True,
    ),
    "05.3": Exercise(
        "in_front(X, R, t): which of the points X (N, 3), given in camera 1, lie in front of both cameras? (N,) of booleans.",
        _in_front,
        (
            (
                lambda X, R, t: X[:, 2] > 0,
                "In front of camera 1 they are; camera 2 sees X2 = R X + t.",
            ),
            (
                lambda X, R, t: (X @ R.T + t)[:, 2] > 0,
                "That is camera 2; a point must lie in front of camera 1 as well.",
            ),
            (
                lambda X, R, t: (X[:, 2] > 0) & ((X @ R + t)[:, 2] > 0),
                "Points are rows here: R X becomes X @ R.T.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(40, 3)), rotation(g), unit(g.normal(size=3)))),
    ),
    "05.4": Exercise(
        "What of the motion can no pair of photographs tell, however good: 'rotation', 'direction of t' or 'length of t'?",
        lambda: "length of t",
        (
            (
                lambda: "rotation",
                "The rotation is what photographs tell best, even without any translation.",
            ),
            (
                lambda: "direction of t",
                "The epipoles are its images. Think of a model railway instead of a railway.",
            ),
        ),
    ),
}
