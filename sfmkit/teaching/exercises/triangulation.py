"""Notebook 06: triangulation."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs, unit


def _midpoint(c1: np.ndarray, d1: np.ndarray, c2: np.ndarray, d2: np.ndarray) -> np.ndarray:
    a, b = np.linalg.lstsq(np.column_stack([d1, -d2]), c2 - c1, rcond=None)[0]
    return (c1 + a * d1 + c2 + b * d2) / 2


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


def _nearest_on(c1: np.ndarray, d1: np.ndarray, c2: np.ndarray, d2: np.ndarray) -> np.ndarray:
    a, _ = np.linalg.lstsq(np.column_stack([d1, -d2]), c2 - c1, rcond=None)[0]
    return c1 + a * d1


_STEREO = random_inputs(lambda g: (g.uniform(500, 2000), g.uniform(0.1, 2), g.uniform(2, 60)))

EXERCISES: dict[str, Exercise] = {
    "06.1": Exercise(
        "depth(f, b, d): the depth of a point with a disparity of d pixels between two parallel "
        "cameras with a focal length of f pixels and a distance of b metres.",
        lambda f, b, d: f * b / d,
        (
            (
                lambda f, b, d: f * d / b,
                "Near points have a larger disparity: divide by the disparity.",
            ),
            (
                lambda f, b, d: b / d,
                "The units do not agree: the focal length is missing.",
            ),
        ),
        _STEREO,
    ),
    "06.2": Exercise(
        "depth_sigma(z, f, b, sigma): the standard deviation of the depth z, to first order, if "
        "the "
        "disparity has the standard deviation sigma (pixels).",
        lambda z, f, b, s: z**2 / (f * b) * s,
        (
            (
                lambda z, f, b, s: z / (f * b) * s,
                "Differentiate z = f b / d with respect to d and insert d = f b / z: z appears "
                "squared.",
            ),
            (
                lambda z, f, b, s: f * b / z**2 * s,
                "This is inverted: the error must grow with the depth.",
            ),
        ),
        random_inputs(
            lambda g: (g.uniform(2, 50), g.uniform(500, 2000), g.uniform(0.1, 2), g.uniform(0.1, 1))
        ),
    ),
    "06.3": Exercise(
        "midpoint(c1, d1, c2, d2): the midpoint of the shortest segment between the rays c1 + a d1 "
        "and c2 + b d2.",
        _midpoint,
        (
            (
                _nearest_on,
                "This end of the segment lies on ray 1. Return the midpoint of both ends.",
            ),
            (
                lambda c1, d1, c2, d2: _nearest_on(c2, d2, c1, d1),
                "This end of the segment lies on ray 2. Return the midpoint of both ends.",
            ),
        ),
        random_inputs(
            lambda g: (
                np.zeros(3),
                unit(g.normal(size=3)),
                g.normal(size=3),
                unit(g.normal(size=3)),
            )
        ),
    ),
    "06.4": Exercise(
        "angle(a, b): the angle between two rays (any lengths), in degrees.",
        lambda a, b: np.degrees(_angle(a, b)),
        (
            (_angle, "This is in radians; np.degrees converts it."),
            (
                lambda a, b: np.degrees(np.arccos(np.clip(a @ b, -1, 1))),
                "The rays do not have unit length. Normalise them.",
            ),
        ),
        random_inputs(lambda g: tuple(g.normal(size=(2, 3)) * 2)),
    ),
}
