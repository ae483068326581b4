"""How each stage is run: one frozen dataclass per stage.

The defaults are our best values; :data:`PAPER` has the values of the paper (Dippold & Tsai,
*Two-View Structure-from-Motion with Multiple Feature Detector Operators*). The paper does not give
all of them; ``PAPER`` is the reading whose counts come closest to its Table 6 (docs/results.md).

:data:`DENSE` finds as many points as the photographs allow at the precision of the default: it
searches keypoints of half the contrast, keeps twice as many, and adds a ratio test, because more
keypoints include more that resemble each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal

from .errors import InputError
from .types import FrozenMapping

Preset = Literal["default", "paper", "dense"]
ModelKind = Literal["essential", "fundamental"]


def _check_positive(name: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name} must be positive pixels, not {value}")


@dataclass(frozen=True)
class DetectOptions:
    """Stage 1, detection and description.

    Attributes:
        preset: Which settings of an operator are used where `overrides` does not say: ours, the
            paper's, or ours with half the least contrast.
        budget: At most this many keypoints per operator and image, spread evenly; None for all.
            Matching costs the product of both images' counts: FAST alone finds 180,000 corners in
            a photograph of roofs.
        max_size: Longest side in pixels at which features are searched; None for full size.
        overrides: Per operator, options that replace the preset's, e.g.
            ``{"surf": {"hessian_threshold": 100}}``.
    """

    preset: Preset = "default"
    budget: int | None = 40_000
    max_size: int | None = None
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=FrozenMapping)


@dataclass(frozen=True)
class MatchOptions:
    """Stage 2, matching.

    Attributes:
        mutual: Keep only matches that are nearest neighbours in both directions.
        max_ratio: Largest ratio of the best to the second-best distance; None for no ratio test.
        max_distance: Largest descriptor distance; None for no limit.
        matcher: Name or import path of the matcher of all operators.
        matchers: Per operator, the matcher that replaces `matcher`.
        overrides: Per operator, options of its matcher.
    """

    mutual: bool = True
    max_ratio: float | None = None
    max_distance: float | None = None
    matcher: str = "nearest"
    matchers: Mapping[str, str] = field(default_factory=FrozenMapping)
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=FrozenMapping)


@dataclass(frozen=True)
class FuseOptions:
    """Stage 2, fusion.

    Attributes:
        merge_radius: Coincident correspondences within this many pixels in both images become one;
            None keeps all.
    """

    merge_radius: float | None = 1.0


@dataclass(frozen=True)
class EstimateOptions:
    """Stage 3, robust estimation of the epipolar geometry.

    Attributes:
        model: ``essential`` (calibrated, five points) or ``fundamental`` (the paper: F, then
            ``E = K2^T F K1``).
        backend: Name or import path of the estimator; ``torch``, ``opencv``, ``poselib`` and
            ``pycolmap`` are built in (the last two need the extra ``peers``).
        method: A method of the estimator, None for its best.
        threshold_px: Largest distance of an inlier to the epipolar line, pixels.
        confidence: Probability of having drawn at least one sample of inliers only.
        max_iterations: At most this many samples.
        refine: Nonlinear refinement of the pose, and then of pose and points, on the inliers.
        overrides: The estimator's own options: keywords that are not part of the contract of
            :class:`sfmkit.estimation.Estimator`.
    """

    model: ModelKind = "essential"
    backend: str = "torch"
    method: str | None = None
    threshold_px: float = 1.0
    confidence: float = 0.9999
    max_iterations: int = 10_000
    refine: bool = True
    overrides: Mapping[str, Any] = field(default_factory=FrozenMapping)

    def __post_init__(self) -> None:
        if self.model not in ("essential", "fundamental"):
            raise InputError(f"model must be 'essential' or 'fundamental', not {self.model!r}")
        _check_positive("threshold_px", self.threshold_px)
        if not 0 < self.confidence < 1:
            raise InputError(f"confidence must lie between 0 and 1, not {self.confidence}")

    def with_backend(self, backend: str) -> EstimateOptions:
        """Return the options with another estimator; method and overrides are reset."""
        if backend == self.backend:
            return self
        return replace(self, backend=backend, method=None, overrides=FrozenMapping())


@dataclass(frozen=True)
class PlanarOptions:
    """Stage 3, robust estimation of a homography (:func:`sfmkit.register`).

    Attributes:
        method: ``prefixes`` (ours), or ``ransac``: OpenCV's on all matches, as in the paper.
        threshold_px: Sampson distance beyond which a match does not count, pixels.
        guided: Match again near the predicted positions, and fit to these matches.
    """

    method: Literal["prefixes", "ransac"] = "prefixes"
    threshold_px: float = 3.0
    guided: bool = True

    def __post_init__(self) -> None:
        if self.method not in ("prefixes", "ransac"):
            raise InputError(f"method must be 'prefixes' or 'ransac', not {self.method!r}")
        _check_positive("threshold_px", self.threshold_px)


@dataclass(frozen=True)
class TriangulateOptions:
    """Stage 3, triangulation.

    Attributes:
        method: ``optimal`` (Lindstrom), ``dlt`` or ``midpoint``.
        max_reprojection_px: Points with a larger root mean square reprojection error are left out;
            None keeps all.
        min_parallax_deg: Points whose rays meet at a smaller angle are left out.
    """

    method: Literal["optimal", "dlt", "midpoint"] = "optimal"
    max_reprojection_px: float | None = None
    min_parallax_deg: float = 0.0


@dataclass(frozen=True)
class Options:
    """All stages together.

    Attributes:
        name: Of the preset that the options start from.
        detect, match, fuse, estimate, planar, triangulate: The stages.
        device: Torch device of detection, matching and the robust search, for those operators,
            matchers and estimators that take one.
    """

    name: str = "default"
    detect: DetectOptions = field(default_factory=DetectOptions)
    match: MatchOptions = field(default_factory=MatchOptions)
    fuse: FuseOptions = field(default_factory=FuseOptions)
    estimate: EstimateOptions = field(default_factory=EstimateOptions)
    planar: PlanarOptions = field(default_factory=PlanarOptions)
    triangulate: TriangulateOptions = field(default_factory=TriangulateOptions)
    device: str = "cpu"


def adjust_preset(
    preset: str,
    *,
    backend: str | None = None,
    threshold_px: float | None = None,
    budget: int | None = None,
    max_size: int | None = None,
) -> Options:
    """The options of a preset with the changes that commands and benchmarks offer.

    Args:
        preset: A key of :data:`PRESETS`.
        backend, threshold_px: Of :class:`EstimateOptions`; None keeps the preset's.
        budget, max_size: Of :class:`DetectOptions`; None keeps the preset's.

    Raises:
        InputError: There is no such preset, or a value is out of range.
    """
    if preset not in PRESETS:
        raise InputError(f"unknown preset '{preset}'; there are {', '.join(PRESETS)}")
    options = PRESETS[preset]
    detect, estimate = options.detect, options.estimate
    if backend is not None:
        estimate = estimate.with_backend(backend)
    if threshold_px is not None:
        estimate = replace(estimate, threshold_px=threshold_px)
    if budget is not None:
        detect = replace(detect, budget=budget)
    if max_size is not None:
        detect = replace(detect, max_size=max_size)
    return replace(options, detect=detect, estimate=estimate)


def as_plain(options: Any) -> Any:
    """Options as nested dicts of plain values, ready for JSON.

    Args:
        options: :class:`Options`, the dataclass of one stage, or a value in one.
    """
    if is_dataclass(options) and not isinstance(options, type):
        return {f.name: as_plain(getattr(options, f.name)) for f in fields(options)}
    if isinstance(options, Mapping):
        return {str(name): as_plain(value) for name, value in options.items()}
    if isinstance(options, (list, tuple)):
        return [as_plain(value) for value in options]
    if hasattr(options, "tolist"):
        return options.tolist()
    if options is None or isinstance(options, (bool, int, float, str)):
        return options
    return repr(options)


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
    planar=PlanarOptions(method="ransac", guided=False),
    triangulate=TriangulateOptions(method="dlt"),
)
DENSE = Options(
    name="dense",
    detect=DetectOptions(preset="dense", budget=80_000),
    match=MatchOptions(max_ratio=0.9),
)
PRESETS: Mapping[str, Options] = FrozenMapping({o.name: o for o in (DEFAULT, DENSE, PAPER)})
