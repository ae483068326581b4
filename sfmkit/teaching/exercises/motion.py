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
        "centre(R, t): the position of camera 2 in the frame of camera 1, given X2 = R X1 + t.",
        lambda R, t: -R.T @ t,
        (
            (
                lambda R, t: t,
                "t is the position of camera 1 in the frame of camera 2 (insert X1 = 0). Solve R "
                "X1 + t "
                "= 0.",
            ),
            (
                lambda R, t: -t,
                "-t is a vector in the axes of camera 2. Rotate it into the axes of camera 1.",
            ),
            (lambda R, t: R.T @ t, "The sign is wrong: the centre is the X1 with R X1 + t = 0."),
            (lambda R, t: -R @ t, "The inverse of a rotation is its transpose."),
        ),
        _POSE,
    ),
    "05.2": Exercise(
        "essential(R, t): the essential matrix of the motion X2 = R X1 + t, up to scale.",
        lambda R, t: hat(t) @ R,
        (
            (
                lambda R, t: R @ hat(t),
                "The order is wrong: multiply X2 = R X1 + t by [t]x from the left, so E = [t]x R.",
            ),
            (
                lambda R, t: hat(t) @ R.T,
                "R already maps camera 1 to camera 2; do not transpose it.",
            ),
            (lambda R, t: hat(t), "This is E of a motion without rotation."),
        ),
        _POSE,
        up_to_scale=True,
    ),
    "05.3": Exercise(
        "in_front(X, R, t): which of the points X (N, 3), given in the frame of camera 1, lie in "
        "front of both cameras? Return (N,) booleans.",
        _in_front,
        (
            (
                lambda X, R, t: X[:, 2] > 0,
                "This tests camera 1 only. The coordinates in camera 2 are X2 = R X + t.",
            ),
            (
                lambda X, R, t: (X @ R.T + t)[:, 2] > 0,
                "This tests camera 2 only. A point must lie in front of camera 1 as well.",
            ),
            (
                lambda X, R, t: (X[:, 2] > 0) & ((X @ R + t)[:, 2] > 0),
                "The points are rows, so R X becomes X @ R.T.",
            ),
        ),
        random_inputs(lambda g: (g.normal(size=(40, 3)), rotation(g), unit(g.normal(size=3)))),
    ),
    "05.4": Exercise(
        "Which part of the motion cannot be determined from any pair of photographs: 'rotation', "
        "'direction of t' or 'length of t'?",
        lambda: "length of t",
        (
            (
                lambda: "rotation",
                "The rotation is the most certain part, and can be determined even without "
                "translation.",
            ),
            (
                lambda: "direction of t",
                "The epipoles are images of this direction. Photographs of a scale model and of "
                "the "
                "original can be identical.",
            ),
        ),
    ),
    "05.5": Exercise(
        "shifted(R, t, s): the translation of the motion that explains the matches if every point "
        "X is matched with its copy at X + s, given in the frame of camera 1.",
        lambda R, t, s: t + R @ s,
        (
            (
                lambda R, t, s: t + s,
                "s is a vector in the axes of camera 1, t in those of camera 2. Rotate s.",
            ),
            (
                lambda R, t, s: t + R.T @ s,
                "R already maps the axes of camera 1 to those of camera 2; do not transpose it.",
            ),
            (
                lambda R, t, s: t - R @ s,
                "The sign is wrong: camera 2 sees the copy at X + s, so X2 = R (X + s) + t.",
            ),
            (lambda R, t, s: t, "This is the true motion, which explains the matches without s."),
        ),
        random_inputs(
            lambda g: (rotation(g), unit(g.normal(size=3)), g.normal(size=3)),
        ),
    ),
}
