"""Features of one operator in one image, and matches between two images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import InputError
from ._checks import check_array

Norm = Literal["l2", "hamming"]


@dataclass(frozen=True, eq=False)
class Features:
    """Features that one operator found in one image.

    Attributes:
        keypoints: (N, 2) float32 pixels of the full-size image: x right, y down, the centre of the
            top-left pixel at (0, 0).
        scales: (N,) float32 diameters of the described neighbourhoods, pixels.
        angles: (N,) float32 orientations in radians, from x towards y (clockwise on screen); 0 for
            upright operators.
        scores: (N,) float32 responses of the detector. Larger is stronger; scores are comparable
            only within one operator.
        descriptors: (N, D) float32, or (N, bytes) uint8 of packed bits.
        norm: How descriptors are compared: ``l2`` or ``hamming``.
        operator: The operator's name.
        size_wh: Size of the image in pixels.
        laplacian: (N,) int8 signs of the Laplacian (+1 dark blob on light, -1 light on dark) if the
            operator computes them (SURF), otherwise None. Features of different sign cannot match.
    """

    keypoints: np.ndarray
    scales: np.ndarray
    angles: np.ndarray
    scores: np.ndarray
    descriptors: np.ndarray
    norm: Norm
    operator: str
    size_wh: tuple[int, int]
    laplacian: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_array("Features", "keypoints", self.keypoints, (None, 2), "f")
        n = len(self.keypoints)
        for name in ("scales", "angles", "scores"):
            check_array("Features", name, getattr(self, name), (n,), "f")
        if self.norm not in ("l2", "hamming"):
            raise InputError(f"Features.norm must be 'l2' or 'hamming', not {self.norm!r}")
        check_array(
            "Features",
            "descriptors",
            self.descriptors,
            (n, None),
            "f" if self.norm == "l2" else "u",
        )
        if self.norm == "hamming" and self.descriptors.dtype != np.uint8:
            raise InputError(
                f"Features.descriptors of norm hamming must be uint8, not {self.descriptors.dtype}"
            )
        if self.laplacian is not None:
            check_array("Features", "laplacian", self.laplacian, (n,), "i")

    def __len__(self) -> int:
        return len(self.keypoints)

    def __repr__(self) -> str:
        return (
            f"Features({self.operator}: {len(self):,} keypoints, {self.descriptors.shape[1]} x "
            f"{self.descriptors.dtype}, {self.norm}, image {self.size_wh[0]} x {self.size_wh[1]})"
        )

    def take(self, index: np.ndarray) -> Features:
        """Return the features at `index` (integers or a mask), in that order."""
        rows = ("keypoints", "scales", "angles", "scores", "descriptors")
        taken = {name: getattr(self, name)[index] for name in rows}
        return replace(
            self, **taken, laplacian=None if self.laplacian is None else self.laplacian[index]
        )


@dataclass(frozen=True, eq=False)
class Matches:
    """Matches of one operator between two images, before fusion.

    Attributes:
        index1, index2: (M,) int64 rows of the two Features.
        distance: (M,) float32 descriptor distances (L2, or number of differing bits).
        ratio: (M,) float32 ratios of the distance to that of the second-nearest neighbour in image
            2, in [0, 1]; NaN if not computed.
    """

    index1: np.ndarray
    index2: np.ndarray
    distance: np.ndarray
    ratio: np.ndarray

    def __post_init__(self) -> None:
        check_array("Matches", "index1", self.index1, (None,), "i")
        n = len(self.index1)
        check_array("Matches", "index2", self.index2, (n,), "i")
        check_array("Matches", "distance", self.distance, (n,), "f")
        check_array("Matches", "ratio", self.ratio, (n,), "f", finite=False)

    def __len__(self) -> int:
        return len(self.index1)
