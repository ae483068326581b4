"""How each stage is run: one frozen dataclass a stage, the defaults being our best, ``PAPER`` the
paper's values.

``DENSE`` is for as many points as the photographs give at the default's precision: keypoints of
half the contrast, twice as many of them, and a ratio test, for among so many there are more that
resemble each other.

The paper (Dippold & Tsai, *Two-View Structure-from-Motion with Multiple Feature Detector
Operators*) leaves some values unsaid; ``PAPER`` is the reading whose counts come closest to its
Table 6 (see docs/results.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from .errors import InputError
from .types import FrozenMapping

Preset = Literal["default", "paper", "dense"]


@dataclass(frozen=True)
class DetectOptions:
    """Stage 1.

    Attributes:
        preset: which settings of an operator are used where `overrides` does not say: ours, the
            paper's, or ours with half the least contrast.
        budget: at most this many keypoints an operator and image, spread evenly; None for all.
            Matching costs the product of both images' counts: FAST alone finds 180,000 corners in a
            photograph of roofs.
        max_size: longest side in pixels at which features are searched; None for full size.
        overrides: per operator, options that replace the preset's, e.g.
            ``{"surf": {"hessian_threshold": 100}}``.
    """

    preset: Preset = "default"
    budget: int | None = 40_000
    max_size: int | None = None
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=FrozenMapping)


@dataclass(frozen=True)
class MatchOptions:
    """Stage 2, matching: mutual nearest neighbours, optionally with a ratio test and a largest
    distance."""

    mutual: bool = True
    max_ratio: float | None = None
    max_distance: float | None = None


@dataclass(frozen=True)
class FuseOptions:
    """Stage 2, fusion.

    Attributes:
        merge_radius: coincident correspondences within this many pixels in both images become one;
            None keeps all.
    """

    merge_radius: float | None = 1.0


@dataclass(frozen=True)
class EstimateOptions:
    """Stage 3, robust estimation.

    Attributes:
        model: ``essential`` (calibrated, five points) or ``fundamental`` (the paper: F, then
            ``E = K2^T F K1``).
        backend: ``torch``, ``opencv``, ``poselib`` or ``pycolmap`` (the last two need the ``peers``
            extra).
        method: the back end's method, None for its best.
        threshold_px: largest distance to the epipolar line of an inlier, pixels.
        confidence: probability of having drawn one sample of inliers only.
        max_iterations: at most this many samples.
        refine: nonlinear refinement of the pose on the inliers.
    """

    model: Literal["essential", "fundamental"] = "essential"
    backend: Literal["torch", "opencv", "poselib", "pycolmap"] = "torch"
    method: str | None = None
    threshold_px: float = 1.0
    confidence: float = 0.9999
    max_iterations: int = 10_000
    refine: bool = True

    def __post_init__(self) -> None:
        if not self.threshold_px > 0:
            raise InputError(f"threshold_px must be positive pixels, not {self.threshold_px}")
        if not 0 < self.confidence < 1:
            raise InputError(f"confidence must lie between 0 and 1, not {self.confidence}")


@dataclass(frozen=True)
class TriangulateOptions:
    """Stage 3, the cloud.

    Attributes:
        method: ``optimal`` (Lindstrom), ``dlt`` or ``midpoint``.
        max_reprojection_px: points with a larger root mean square reprojection error are left out;
            None keeps all.
        min_parallax_deg: points whose rays meet at a smaller angle are left out.
    """

    method: Literal["optimal", "dlt", "midpoint"] = "optimal"
    max_reprojection_px: float | None = None
    min_parallax_deg: float = 0.0


@dataclass(frozen=True)
class Options:
    """All stages together."""

    name: str = "default"
    detect: DetectOptions = field(default_factory=DetectOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    fuse: FuseOptions = field(default_factory=FuseOptions)
    estimate: EstimateOptions = field(default_factory=EstimateOptions)
    triangulate: TriangulateOptions = field(default_factory=TriangulateOptions)


DEFAULT = Options()
PAPER = Options(
    name="paper",
    detect=DetectOptions(preset="paper", budget=None),
    fuse=FuseOptions(merge_radius=None),
    estimate=EstimateOptions(
        model="fundamental",
        backend="opencv",
        method="ransac",
        threshold_px=3.0,
        confidence=0.999999,
        refine=False,
    ),
    triangulate=TriangulateOptions(method="dlt"),
)
DENSE = Options(
    name="dense",
    detect=DetectOptions(preset="dense", budget=80_000),
    match=MatchOptions(max_ratio=0.9),
)
PRESETS: Mapping[str, Options] = FrozenMapping({o.name: o for o in (DEFAULT, DENSE, PAPER)})
