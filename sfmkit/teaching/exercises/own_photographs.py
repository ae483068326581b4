"""Notebook 09: your own photographs."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise
from ._inputs import camera, random_inputs


def _resized(K: np.ndarray, s: float, half: float = 0.5, focal: bool = True) -> np.ndarray:
    out = K.astype(float).copy()
    if focal:
        out[:2, :2] *= s
    out[:2, 2] = (out[:2, 2] + half) * s - half
    return out


EXERCISES: dict[str, Exercise] = {
    "09.1": Exercise(
        "focal_px(f35, w, h): the focal length in pixels of a w x h photograph whose EXIF says f35 mm (35 mm equivalent, "
        "by the diagonal of the 36 x 24 mm frame).",
        lambda f35, w, h: f35 / np.hypot(36, 24) * np.hypot(w, h),
        (
            (
                lambda f35, w, h: f35 / 36 * w,
                "That takes the equivalent by the frame's width; it is defined by the diagonal. For 3:2 it is the same, here not.",
            ),
            (
                lambda f35, w, h: f35 * np.hypot(36, 24) / np.hypot(w, h),
                "Upside down: more pixels make a longer focal length in pixels.",
            ),
        ),
        lambda: ((26.0, 4000, 3000), (50.0, 1920, 1080), (28.0, 3000, 4000)),
    ),
    "09.2": Exercise(
        "resize(K, s): the intrinsics of the photograph resized by the factor s, where the centre of the top-left pixel is "
        "(0, 0).",
        lambda K, s: _resized(K, s),
        (
            (
                lambda K, s: _resized(K, s, half=0.0),
                "The image's corner stays where it is, at (-½, -½), not the first pixel's centre: c' = (c + ½) s - ½.",
            ),
            (
                lambda K, s: _resized(K, s, focal=False),
                "The focal length is in pixels too, and scales with them.",
            ),
            (lambda K, s: K * s, "The last row stays (0, 0, 1)."),
        ),
        random_inputs(lambda g: (camera(g), g.choice([0.25, 0.5, 2.0]))),
        tolerance=1e-6,
    ),
    "09.3": Exercise(
        "Which pair gives no cloud at all: 'a step to the side', 'a step forward' or 'turning on the spot'?",
        lambda: "turning on the spot",
        (
            (
                lambda: "a step to the side",
                "That is the best pair there is: the parallax is large everywhere.",
            ),
            (
                lambda: "a step forward",
                "Only what lies straight ahead, near the epipole, has no parallax then.",
            ),
        ),
    ),
}
