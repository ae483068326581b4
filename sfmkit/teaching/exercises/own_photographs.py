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
        "focal_px(f35, w, h): the focal length in pixels of a w x h photograph with a 35 mm "
        "equivalent of f35 mm in EXIF, defined by the diagonal of the 36 x 24 mm frame.",
        lambda f35, w, h: f35 / np.hypot(36, 24) * np.hypot(w, h),
        (
            (
                lambda f35, w, h: f35 / 36 * w,
                "This uses the width of the frame, but the equivalent is defined by the diagonal. "
                "The "
                "results agree for an aspect ratio of 3:2 only.",
            ),
            (
                lambda f35, w, h: f35 * np.hypot(36, 24) / np.hypot(w, h),
                "This is inverted: with more pixels, the focal length in pixels is larger.",
            ),
        ),
        lambda: ((26.0, 4000, 3000), (50.0, 1920, 1080), (28.0, 3000, 4000)),
    ),
    "09.2": Exercise(
        "resize(K, s): the intrinsics of the photograph after resizing by the factor s; the centre "
        "of the top-left pixel is (0, 0).",
        lambda K, s: _resized(K, s),
        (
            (
                lambda K, s: _resized(K, s, half=0.0),
                "The corner of the image, (-½, -½), keeps its position, not the centre of the "
                "first "
                "pixel: c' = (c + ½) s - ½.",
            ),
            (
                lambda K, s: _resized(K, s, focal=False),
                "The focal length is also in pixels, so it is scaled as well.",
            ),
            (lambda K, s: K * s, "The last row remains (0, 0, 1)."),
        ),
        random_inputs(lambda g: (camera(g), g.choice([0.25, 0.5, 2.0]))),
        tolerance=1e-6,
    ),
    "09.3": Exercise(
        "Which pair does not give a cloud: 'a step to the side', 'a step forward' or 'turning on "
        "the "
        "spot'?",
        lambda: "turning on the spot",
        (
            (
                lambda: "a step to the side",
                "This is the best pair: the parallax is large everywhere.",
            ),
            (
                lambda: "a step forward",
                "Only points near the epipole, in the direction of the motion, have no parallax.",
            ),
        ),
    ),
}
