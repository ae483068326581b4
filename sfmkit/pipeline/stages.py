"""The stages of the pipeline, one function per stage.

Each stage takes the results of the stages before it, so a notebook can stop after any of them.
:func:`~sfmkit.pipeline.reconstruction.reconstruct` and
:func:`~sfmkit.pipeline.registration.register` call them in order and keep all results.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .._utils.labels import label
from .._utils.notices import warn
from .._utils.progress import Progress
from ..errors import CameraError, InputError, OperatorError
from ..estimation import (
    Adjustment,
    adjust,
    check_estimator,
    estimate_with_focal,
    undistorted_pixels,
)
from ..features import OPERATOR_PLUGINS, detect
from ..geometry.coordinates import normalize
from ..geometry.pose import rotation_error, translation_error
from ..geometry.reprojection import project
from ..geometry.triangulation import parallax, triangulate
from ..io.calibration import Calibration
from ..io.cameras import camera_from_exif
from ..io.images import Image
from ..io.intrinsics import fit_intrinsics, parse_intrinsics
from ..matching import MATCHER_PLUGINS, choose_matchers, fuse, matcher_of, run_matcher
from ..options import (
    DetectOptions,
    EstimateOptions,
    FuseOptions,
    MatchOptions,
    Options,
    TriangulateOptions,
)
from ..types import MAX_OPERATORS, Camera, Correspondences, Features, Matches, PointCloud, TwoView

OPERATORS_OF_THE_PAPER = ("surf", "orb", "fast-brief")

ImageLike = Image | np.ndarray | str | PathLike
CameraLike = Camera | np.ndarray | str | PathLike
FeaturePairs = Mapping[str, tuple[Features, Features]]


@dataclass
class Stopwatch:
    """A stopwatch that measures the seconds of each stage and reports progress."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, detail: str = ""):
        """Add the time of the block to a stage."""
        self.say(name, detail)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def say(self, name: str, detail: str) -> None:
        """Report progress if a callback was given."""
        if self.progress is not None:
            self.progress(name, detail)


def choose_options(
    options: Options,
    operators: Sequence[str],
    *,
    matchers: str | Mapping[str, str] | None = None,
    device: str | torch.device | None = None,
    seed: int = 0,
) -> Options:
    """Complete the options of a run and check them before the work starts.

    Args:
        options: A preset or the caller's own options.
        operators: The operators of the run.
        matchers: The name of a matcher for all operators, or a mapping operator -> matcher; None
            keeps those of the options.
        device: Torch device; None keeps that of the options.
        seed: Seed, which is only checked; from 0 to 2^31 - 1.

    Raises:
        InputError: The seed is out of range, matchers or overrides are given for operators that are
            not used, a matcher or estimator is unknown, the estimator does not take the options,
            or the device is not available.
        OperatorError: No operator or more than 62 are given, or one is unknown.
    """
    if not operators:
        raise OperatorError("no operator given; name at least one, e.g. operators=('surf', 'orb')")
    if len(operators) > MAX_OPERATORS:
        raise OperatorError(f"at most {MAX_OPERATORS} operators can be fused, not {len(operators)}")
    if not 0 <= seed < 2**31:
        raise InputError(f"seed must be from 0 to 2^31 - 1, not {seed}")
    for name in operators:
        OPERATOR_PLUGINS[name]
    match = choose_matchers(options.match, matchers)
    for owner, names in (
        ("options", options.detect.overrides),
        ("options of a matcher", match.overrides),
        ("a matcher", match.matchers),
    ):
        unused = [name for name in names if name not in operators]
        if unused:
            raise InputError(f"{owner} for operators that are not used: {', '.join(unused)}")
    for name in operators:
        MATCHER_PLUGINS[matcher_of(name, match)]
    estimate = options.estimate
    check_estimator(
        estimate.backend,
        model=estimate.model,
        method=estimate.method,
        overrides=estimate.overrides,
    )
    chosen = options.device if device is None else str(device)
    check_device(chosen)
    return replace(options, match=match, device=chosen)


def check_device(device: str) -> None:
    """Check that torch can compute on a device.

    Raises:
        InputError: The name is malformed, or the device is not available.
    """
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"device '{device}' cannot be used: {reason}") from error


def choose_cameras(
    images: tuple[Image, Image], camera: CameraLike | None, camera2: CameraLike | None = None
) -> tuple[Camera, Camera]:
    """Choose the cameras of both images, as given or from EXIF, and check their sizes.

    Args:
        images: Image 1 and image 2.
        camera: Camera of image 1, and of image 2 if `camera2` is None; None reads EXIF.
        camera2: Camera of image 2, if it was taken by another camera.

    Raises:
        CameraError: The intrinsics are impossible, or belong to an image of another size.
    """
    first = _camera(camera, images[0])
    if camera2 is None and camera is not None:
        second = first if images[0].size_wh == images[1].size_wh else _same_lens(first, images[1])
    else:
        second = _camera(camera2, images[1])
    for number, (cam, image) in enumerate(zip((first, second), images), start=1):
        if cam.size_wh != image.size_wh:
            raise CameraError(
                f"the camera of image {number} is for {cam.size_wh[0]} x {cam.size_wh[1]} pixels, "
                f"the image has {image.size_wh[0]} x {image.size_wh[1]}; use Camera.scaled if it "
                "was resized"
            )
    return first, second


def _camera(camera: CameraLike | None, image: Image) -> Camera:
    if camera is None:
        return camera_from_exif(image)
    if isinstance(camera, Camera):
        return camera
    orientation = image.exif.orientation if image.exif else 1
    if isinstance(camera, np.ndarray):
        return fit_intrinsics(Calibration(camera), image.size_wh, orientation=orientation)
    return parse_intrinsics(camera, image.size_wh, orientation=orientation)


def _same_lens(camera: Camera, image: Image) -> Camera:
    """Scale `camera` to an image of the same aspect ratio, and raise CameraError for others."""
    (w, h), (w1, h1) = image.size_wh, camera.size_wh
    if abs(w / w1 - h / h1) > 0.01 * w / w1:
        raise CameraError(
            f"image 2 ({w} x {h}) is not a scaled version of image 1 ({w1} x {h1}); give its own "
            "intrinsics (camera2, on the command line --intrinsics2)"
        )
    return camera.scaled((w, h))


def detect_all(
    images: tuple[Image, Image],
    operators: Sequence[str],
    options: DetectOptions,
    watch: Stopwatch | None = None,
    *,
    device: str | None = None,
) -> dict[str, tuple[Features, Features]]:
    """Stage 1: run every operator on both images.

    An operator that finds nothing has empty features in the result, and a warning is issued.

    Raises:
        OperatorError: An operator is unknown, is not available, or fails.
    """
    watch = watch or Stopwatch()
    features: dict[str, tuple[Features, Features]] = {}
    for name in dict.fromkeys(operators):
        found = []
        for number, image in enumerate(images, start=1):
            watch.say("detect", f"{name}, image {number}")
            found.append(
                detect(
                    image,
                    name,
                    budget=options.budget,
                    max_size=options.max_size,
                    preset=options.preset,
                    device=device,
                    **options.overrides.get(name, {}),
                )
            )
            if not len(found[-1]):
                warn(f"operator '{name}' found nothing in image {number}", stacklevel=2)
        features[name] = (found[0], found[1])
    return features


def match_all(
    features: FeaturePairs,
    options: MatchOptions,
    watch: Stopwatch | None = None,
    *,
    device: str | None = None,
) -> dict[str, Matches]:
    """Stage 2, matching: match the features of each operator with its matcher."""
    watch = watch or Stopwatch()
    matches = {}
    for name, (f1, f2) in features.items():
        watch.say("match", f"{name}, {len(f1):,} x {len(f2):,}")
        matches[name] = run_matcher(f1, f2, options, operator=name, device=device)
    return matches


def fuse_all(
    features: FeaturePairs, matches: Mapping[str, Matches], options: FuseOptions
) -> Correspondences:
    """Stage 2, fusion: merge the matches of all operators into one set of correspondences."""
    return fuse(
        {name: (*features[name], matches[name]) for name in matches},
        merge_radius=options.merge_radius,
    )


def estimate_geometry(
    corr: Correspondences,
    cameras: tuple[Camera, Camera],
    options: EstimateOptions | None = None,
    *,
    seed: int = 0,
    device: str | None = None,
    watch: Stopwatch | None = None,
) -> tuple[TwoView, Adjustment | None]:
    """Stage 3: estimate the geometry of two views and refine pose and points together.

    Args:
        corr: N correspondences in pixels of the photographs.
        cameras: Cameras of image 1 and image 2; those of the geometry may have estimated focal
            lengths.
        options: Options of the estimation; ``refine=False`` switches the refinement off.
        seed: The same seed gives the same result on the same machine.
        device: Torch device, for estimators with such a parameter.

    Returns:
        The geometry, refined if it has a translation, and the bundle adjustment that refined it,
        or None.
    """
    options, watch = options or EstimateOptions(), watch or Stopwatch()
    with watch.stage("estimate", "epipolar geometry and pose"):
        view = estimate_with_focal(corr, *cameras, options, seed=seed, device=device)
    if not options.refine:
        return view, None
    with watch.stage("refine", "pose and points together"):
        adjustment = adjust(corr, view)
    return (view if adjustment is None else adjustment.view), adjustment


def make_cloud(
    corr: Correspondences,
    view: TwoView,
    image1: Image,
    options: TriangulateOptions | None = None,
    adjustment: Adjustment | None = None,
) -> PointCloud | None:
    """Stage 3, last part: triangulate the inliers.

    Args:
        corr: N correspondences.
        view: Their geometry.
        image1: Image 1, from which the colours are taken.
        options: Method and limits.
        adjustment: The bundle adjustment that refined `view`; it supplies the covariances.

    Returns:
        The finite points in front of both cameras and within the limits; ``match`` contains their
        rows in `corr`. None if the geometry has no translation.
    """
    if view.R is None or view.t is None:
        return None
    options = options or TriangulateOptions()
    rows = view.inliers.nonzero().squeeze(1)
    x1, x2 = undistorted_pixels(corr, view.camera1, view.camera2)
    (K1, _), (K2, _) = view.camera1.tensors(), view.camera2.tensors()
    xn1, xn2 = normalize(x1[rows], K1), normalize(x2[rows], K2)
    X = triangulate(xn1, xn2, view.R, view.t, method=options.method)
    X2 = X @ view.R.mT + view.t
    e1, e2 = project(X, K1) - x1[rows], project(X2, K2) - x2[rows]
    error = ((e1.square().sum(-1) + e2.square().sum(-1)) / 2).sqrt()
    angle = torch.rad2deg(parallax(xn1, xn2, view.R))
    keep = (
        torch.isfinite(X).all(-1)
        & (X[:, 2] > 0)
        & (X2[:, 2] > 0)
        & (angle >= options.min_parallax_deg)
    )
    if options.max_reprojection_px is not None:
        keep &= error <= options.max_reprojection_px
    rows = rows[keep]
    return PointCloud(
        xyz=X[keep],
        rgb=sample_colours(image1, corr.x1[rows]),
        operator_id=corr.operator_id[rows],
        operator_mask=corr.operator_mask[rows],
        operators=corr.operators,
        reprojection_error=error[keep],
        parallax=angle[keep],
        match=rows,
        covariance=None if adjustment is None else adjustment.covariance[keep],
    )


def sample_colours(image: Image, x: Tensor) -> Tensor:
    """Return the (N, 3) uint8 colours of the pixels nearest to x (N, 2)."""
    w, h = image.size_wh
    c = x.round().long()
    return torch.from_numpy(
        np.ascontiguousarray(image.rgb[c[:, 1].clamp(0, h - 1), c[:, 0].clamp(0, w - 1)])
    )


def pose_errors(view: TwoView, R: np.ndarray, t: np.ndarray) -> dict[str, float]:
    """Compute the errors of rotation and translation direction, degrees; NaN where unknown.

    Args:
        view: The estimate.
        R, t: (3, 3) and (3,), the true pose; t up to scale.
    """
    nan = float("nan")
    if view.R is None:
        return {"rotation_deg": nan, "translation_deg": nan}
    R_true, t_true = (torch.tensor(np.asarray(a), dtype=torch.float64) for a in (R, t))
    return {
        "rotation_deg": float(rotation_error(view.R, R_true)),
        "translation_deg": nan if view.t is None else float(translation_error(view.t, t_true)),
    }


def name_of(image: Image, number: int) -> str:
    """Return the name of an image in outputs: its file name, or its number."""
    return label(Path(image.path).name) if image.path else f"image{number}"
