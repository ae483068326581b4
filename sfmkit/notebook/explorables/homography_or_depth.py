"""Homography or depth: what matches show, by the criterion of the verdict."""

from __future__ import annotations

from typing import ClassVar

from .bundle import bundle
from .explorable import Explorable

__all__ = ["HomographyOrDepth"]


class HomographyOrDepth(Explorable):
    """Points on a plane that can be dragged off it, and the verdict on their matches.

    The browser computes the homography, the rotation and the criterion of
    :mod:`sfmkit.estimation.verdict` from noisy matches of the scene; F is that of the true motion.
    """

    title: ClassVar[str] = "Homography or depth?"
    height: ClassVar[int] = 900
    _esm = bundle("homography_or_depth")

    def __init__(self) -> None:
        super().__init__(data={})
