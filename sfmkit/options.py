"""Options of the stages: one frozen dataclass per stage.

The defaults are the best values known. :data:`PAPER` contains the values of the paper (Dippold &
Tsai, *Two-View Structure-from-Motion with Multiple Feature Detector Operators*). The paper does not
state all of them; ``PAPER`` is the interpretation whose counts come closest to Table 6 of the paper
(docs/results.md).

:data:`DENSE` finds as many points as the photographs permit at the precision of the default. It
detects keypoints of half the contrast, keeps twice as many, and adds a ratio test, because a larger
set of keypoints contains more that resemble each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal

from .errors import InputError
from .types import FrozenMapping

Preset = Literal["default", "paper", "dense"]
ModelKind = Literal["essential", "fundamental"]
FocalChoice = Literal["estimate", "fixed"]


def _check_positive(name: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name} must be positive pixels, not {value}")


@dataclass(frozen=True)
class DetectOptions:
    """Options of stage 1, detection and description.

    Attributes:
        preset: Settings of the operators: ``default``, ``paper`` (those of the paper) or ``dense``
            (the default with half the minimum contrast).
        budget: Maximum number of keypoints per operator and image, spread evenly; None for all. The
            time of matching is proportional to the product of the numbers in both images: FAST
            alone finds 180,000 corners in a photograph of roofs.
        max_size: Longest side in pixels at which features are detected; None for the full size.
        overrides: Per operator, options that replace those of the preset, such as
            ``{"surf": {"hessian_threshold": 100}}``.
    """

    preset: Preset = "default"
    budget: int | None = 40_000
    max_size: int | None = None
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=FrozenMapping)


@dataclass(frozen=True)
class MatchOptions:
    """Options of stage 2, matching.

    Attributes:
        mutual: Keep only matches that are nearest neighbours in both directions.
        max_ratio: Largest ratio of the best to the second-best distance; None for no ratio test.
        max_distance: Largest descriptor distance; None for no limit.
        matcher: Name or import path of the matcher for all operators.
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
    """Options of stage 2, fusion.

    Attributes:
        merge_radius: Correspondences that coincide to within this many pixels in both images are
            merged into one; None keeps all.
    """

    merge_radius: float | None = 1.0


@dataclass(frozen=True)
class EstimateOptions:
    """Options of stage 3, robust estimation of the epipolar geometry.

    Attributes:
        model: ``essential`` (calibrated, five points) or ``fundamental`` (the paper: F, then
            ``E = K2^T F K1``).
        backend: Name or import path of the estimator; ``torch``, ``opencv``, ``poselib`` and
            ``pycolmap`` are built in (the last two need the extra ``peers``).
        method: A method of the estimator; None for its best one.
        threshold_px: Largest distance of an inlier from the epipolar geometry, pixels.
        confidence: Probability that at least one sample contains only inliers.
        max_iterations: Maximum number of samples.
        refine: Whether to refine the pose, and then the pose and the points together, on the
            inliers.
        focal: ``estimate`` estimates focal lengths that are guessed, or about which EXIF disagrees,
            from the matches where these determine them better; ``fixed`` keeps them.
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
    focal: FocalChoice = "estimate"
    overrides: Mapping[str, Any] = field(default_factory=FrozenMapping)

    def __post_init__(self) -> None:
        if self.model not in ("essential", "fundamental"):
            raise InputError(f"model must be 'essential' or 'fundamental', not {self.model!r}")
        if self.focal not in ("estimate", "fixed"):
            raise InputError(f"focal must be 'estimate' or 'fixed', not {self.focal!r}")
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
    """Options of stage 3, robust estimation of a homography (:func:`sfmkit.register`).

    Attributes:
        method: ``prefixes`` (that of sfmkit), or ``ransac``: OpenCV's RANSAC on all matches, as in
            the paper.
        threshold_px: Sampson distance in pixels beyond which a match has no weight.
        guided: Whether to match again near the predicted positions and fit H to these matches.
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
    """Options of stage 3, triangulation.

    Attributes:
        method: ``optimal`` (Lindstrom), ``dlt`` or ``midpoint``.
        max_reprojection_px: Largest root mean square reprojection error of a point in pixels; None
            keeps all points.
        min_parallax_deg: Smallest angle between the rays of a point in degrees.
    """

    method: Literal["optimal", "dlt", "midpoint"] = "optimal"
    max_reprojection_px: float | None = None
    min_parallax_deg: float = 0.0


@dataclass(frozen=True)
class Options:
    """Options of all stages.

    Attributes:
        name: Name of the preset from which the options start.
        detect, match, fuse, estimate, planar, triangulate: Options of the stages.
        device: Torch device for detection, matching and the robust search, passed to operators,
            matchers and estimators with such a parameter.
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
    focal: FocalChoice | None = None,
) -> Options:
    """Return the options of a preset with some values replaced.

    Args:
        preset: A key of :data:`PRESETS`.
        backend, threshold_px, focal: Values of :class:`EstimateOptions`; None keeps those of the
            preset.
        budget, max_size: Values of :class:`DetectOptions`; None keeps those of the preset.

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
    if focal is not None:
        estimate = replace(estimate, focal=focal)
    if budget is not None:
        detect = replace(detect, budget=budget)
    if max_size is not None:
        detect = replace(detect, max_size=max_size)
    return replace(options, detect=detect, estimate=estimate)


def as_plain(options: Any) -> Any:
    """Convert options to nested dictionaries of plain values for JSON.

    Args:
        options: :class:`Options`, the dataclass of one stage, or one of its values.
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
        focal="fixed",
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
