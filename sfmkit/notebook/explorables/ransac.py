"""RANSAC step by step: samples, models, consensus sets and the stopping rule."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...errors import InputError
from .bundle import bundle
from .explorable import Explorable, photograph_data, rounded

__all__ = ["RansacSteps"]

MATCHES = 150  # in the problem of F, right and wrong ones together


class RansacSteps(Explorable):
    """Draw samples one by one, for a line and for F of the matches of two photographs.

    A slider chooses the share of wrong matches. If there are fewer wrong matches than right ones,
    right matches with exchanged partners are added to them.

    Args:
        image1, image2: (H, W, 3) uint8 RGB.
        x1, x2: (N, 2) pixels.
        right: (N,) bool, which matches are right; at least 16.
        seed: of the choice of matches.

    Raises:
        InputError: too few right matches, or shapes that do not fit.
    """

    title: ClassVar[str] = "RANSAC, step by step"
    _esm = bundle("ransac")

    def __init__(
        self, image1: np.ndarray, image2: np.ndarray, x1: Any, x2: Any, right: Any, seed: int = 0
    ):
        matches, chosen = np.hstack([np.asarray(x1), np.asarray(x2)]), np.asarray(right, dtype=bool)
        if matches.shape != (len(chosen), 4):
            raise InputError(f"{len(chosen)} flags, but matches of shape {matches.shape}")
        if chosen.sum() < 16:
            raise InputError(f"the explorable needs 16 right matches, not {chosen.sum()}")
        generator = np.random.default_rng(seed)
        good = _some(matches[chosen], generator)
        exchanged = np.hstack([good[:, :2], np.roll(good[:, 2:], len(good) // 2, axis=0)])
        wrong = np.concatenate([_some(matches[~chosen], generator), exchanged])
        data: dict[str, Any] = {
            "images": [photograph_data(image) for image in (image1, image2)],
            "right": rounded(good, 7),
            "wrong": rounded(wrong[: len(good)], 7),
        }
        super().__init__(data=data)


def _some(matches: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """At most MATCHES of the matches, in random order."""
    return matches[generator.permutation(len(matches))[:MATCHES]]
