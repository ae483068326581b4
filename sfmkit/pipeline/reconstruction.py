"""The stages composed: two photographs in, geometry and a coloured cloud with provenance out.

Each stage is a function of the stages before it, so that a notebook can stop after any of them;
:func:`reconstruct` calls them in order and keeps everything they made.
"""

from __future__ import annotations

import time
import warnings as python_warnings
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .._utils.labels import label
from .._utils.progress import Progress
from ..errors import CameraError, InputError, OperatorError
from ..estimation import (
    Adjustment,
    adjust,
    estimate_two_view,
    undistorted_pixels,
    within_the_field,
)
from ..features import detect
from ..geometry.coordinates import normalize
from ..geometry.pose import rotation_error, translation_error
from ..geometry.reprojection import project
from ..geometry.triangulation import parallax, triangulate
from ..io.calibration import Calibration
from ..io.cameras import camera_from_exif
from ..io.images import Image, read_image
from ..io.intrinsics import fit_intrinsics, parse_intrinsics
from ..matching.fusion import fuse
from ..matching.plugins import run_matcher
from ..options import DEFAULT, DetectOptions, MatchOptions, Options, TriangulateOptions
from ..types import Camera, Correspondences, Features, Matches, PointCloud, TwoView, Verdict
from .account import OperatorAccount, make_account

OPERATORS_OF_THE_PAPER = ("surf", "orb", "fast-brief")

ImageLike = Image | np.ndarray | str | PathLike
CameraLike = Camera | np.ndarray | str | PathLike
FeaturePairs = Mapping[str, tuple[Features, Features]]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Everything a run made, stage by stage.

    Attributes:
        images: the two photographs.
        features: per operator, what it found in both images.
        matches: per operator, before fusion.
        correspondences: fused, in pixels of the photographs (with their distortion).
        two_view: the geometry, its verdict and its inliers.
        cloud: triangulated points, None where the verdict allows none.
        account: per operator and for all (``multi``), what went in and came out.
        options, seed: what it was made with.
        timings_s: seconds per stage.
        warnings: what went not quite as asked.
        errors: against the truth, if it was given: ``rotation_deg``, ``translation_deg``.
    """

    images: tuple[Image, Image]
    features: FeaturePairs
    matches: Mapping[str, Matches]
    correspondences: Correspondences
    two_view: TwoView
    cloud: PointCloud | None
    account: Mapping[str, OperatorAccount]
    options: Options
    seed: int
    timings_s: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    errors: Mapping[str, float] | None = None

    @property
    def trustworthy(self) -> bool:
        """Whether there is a geometry to rely on (any verdict but too little evidence)."""
        return self.two_view.verdict is not Verdict.TOO_LITTLE

    @property
    def reprojection_rmse_px(self) -> float | None:
        """Root mean square reprojection error of the cloud over both images, pixels."""
        if self.cloud is None or not len(self.cloud):
            return None
        return float(self.cloud.reprojection_error.square().mean().sqrt())


@dataclass
class Stopwatch:
    """Measure seconds per stage and report progress."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, detail: str = ""):
        self.say(name, detail)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def say(self, name: str, detail: str) -> None:
        if self.progress is not None:
            self.progress(name, detail)


def reconstruct(
    image1: ImageLike,
    image2: ImageLike,
    camera: CameraLike | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    *,
    camera2: CameraLike | None = None,
    options: Options = DEFAULT,
    seed: int = 0,
    truth: tuple[np.ndarray, np.ndarray] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Two overlapping photographs to a coloured cloud, with an account of what each operator
    contributed.

    Args:
        image1, image2: paths, (H, W, 3) uint8 RGB or (H, W) uint8 grey arrays, or :class:`Image`.
        camera: intrinsics of image 1, and of image 2 unless `camera2` is given: a :class:`Camera`,
            a (3, 3) K, or what :func:`sfmkit.io.intrinsics.parse_intrinsics` takes (a file,
            ``fx,fy,cx,cy``); None reads them from EXIF.
        operators: names of operators (see ``sfmkit operators``), or ``detector+descriptor``.
        options: :data:`sfmkit.options.DEFAULT` or :data:`sfmkit.options.PAPER`, or your own.
        seed: the same seed gives the same result on the same machine.
        truth: (R, t) with ``X2 = R X1 + t`` to compare with; t up to scale.
        progress: called with (stage, what is being done).

    Raises:
        InputError: for images, cameras and operators that cannot be used. A geometry that the
            matches do not support
            is not an error: it is the verdict of ``result.two_view``.
    """
    watch = Stopwatch(progress)
    began = time.perf_counter()
    with python_warnings.catch_warnings(record=True) as caught:
        python_warnings.simplefilter("always")
        with watch.stage("read", "photographs and cameras"):
            images = (read_image(image1), read_image(image2))
            cameras = choose_cameras(images, camera, camera2)
        with watch.stage("detect"):
            features, dropped = detect_all(
                images, operators, options.detect, watch, device=options.device
            )
        with watch.stage("match"):
            matches = match_all(features, options.match, watch, device=options.device)
        with watch.stage("fuse", "matches of all operators"):
            corr = fuse(
                {name: (*features[name], matches[name]) for name in features},
                merge_radius=options.fuse.merge_radius,
            )
            corr = within_the_field(corr, *cameras)
        with watch.stage("estimate", "epipolar geometry and pose"):
            two_view = estimate_two_view(
                corr, *cameras, options.estimate, seed=seed, device=options.device
            )
        adjustment = None
        if options.estimate.refine:
            with watch.stage("refine", "pose and points together"):
                adjustment = adjust(corr, two_view)
        two_view = two_view if adjustment is None else adjustment.view
        with watch.stage("triangulate", "points"):
            cloud = make_cloud(corr, two_view, images[0], options.triangulate, adjustment)
    watch.seconds["total"] = time.perf_counter() - began
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)] + dropped
    return Reconstruction(
        images=images,
        features=features,
        matches=matches,
        correspondences=corr,
        two_view=two_view,
        cloud=cloud,
        account=make_account(corr, two_view.inliers, cloud),
        options=options,
        seed=seed,
        timings_s=dict(watch.seconds),
        warnings=tuple(dict.fromkeys(notes)),
        errors=None if truth is None else pose_errors(two_view, *truth),
    )


def choose_cameras(
    images: tuple[Image, Image], camera: CameraLike | None, camera2: CameraLike | None = None
) -> tuple[Camera, Camera]:
    """The cameras of both images: as given, or from EXIF; checked against the images' sizes.

    Raises:
        CameraError: no camera can have these intrinsics, or they are for another size than the
            image.
    """
    first = _camera(camera, images[0])
    if camera2 is None and camera is not None:
        second = first if images[0].size_wh == images[1].size_wh else _same_lens(first, images[1])
    else:
        second = _camera(camera2, images[1])
    for number, (cam, image) in enumerate(zip((first, second), images), start=1):
        if cam.size_wh != image.size_wh:
            raise CameraError(
                f"the camera of image {number} is for {cam.size_wh[0]} x {cam.size_wh[1]} pixels, the image has "
                f"{image.size_wh[0]} x {image.size_wh[1]}; use Camera.scaled if it was resized"
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
    """`camera` for another image of the same shape; a crop or another camera needs its own
    intrinsics."""
    (w, h), (w1, h1) = image.size_wh, camera.size_wh
    if abs(w / w1 - h / h1) > 0.01 * w / w1:
        raise CameraError(
            f"image 2 ({w} x {h}) is not a scaled version of image 1 ({w1} x {h1}); give its own intrinsics "
            "(camera2, on the command line --intrinsics2)"
        )
    return camera.scaled((w, h))


def detect_all(
    images: tuple[Image, Image],
    operators: Sequence[str],
    options: DetectOptions,
    watch: Stopwatch | None = None,
    *,
    device: str | None = None,
) -> tuple[dict[str, tuple[Features, Features]], list[str]]:
    """Stage 1: every operator on both images.

    Returns:
        features per operator, and notes about operators that found nothing (they stay, with no
        features).

    Raises:
        OperatorError: unknown or unavailable operators, or none at all.
    """
    names = tuple(dict.fromkeys(operators))
    if not names:
        raise OperatorError("no operator given; name at least one, e.g. operators=('surf', 'orb')")
    unknown = [name for name in options.overrides if name not in names]
    if unknown:
        raise InputError(f"options for operators that are not used: {', '.join(unknown)}")
    watch = watch or Stopwatch()
    features: dict[str, tuple[Features, Features]] = {}
    notes = []
    for name in names:
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
                notes.append(f"operator '{name}' found nothing in image {number}")
        features[name] = (found[0], found[1])
    return features, notes


def match_all(
    features: FeaturePairs,
    options: MatchOptions,
    watch: Stopwatch | None = None,
    *,
    device: str | None = None,
) -> dict[str, Matches]:
    """Stage 2: every operator's features matched with their own norm."""
    watch = watch or Stopwatch()
    matches = {}
    for name, (f1, f2) in features.items():
        watch.say("match", f"{name}, {len(f1):,} x {len(f2):,}")
        matches[name] = run_matcher(f1, f2, options, operator=name, device=device)
    return matches


def make_cloud(
    corr: Correspondences,
    view: TwoView,
    image1: Image,
    options: TriangulateOptions | None = None,
    adjustment: Adjustment | None = None,
) -> PointCloud | None:
    """Stage 3, last part: triangulate the inliers; None where the geometry has no translation.

    With the `adjustment` that gave `view` its pose, the points carry their covariance. Points that
    come out behind a camera or at infinity, or that the options exclude, are left out; ``match`` of
    the cloud says which correspondences stayed.
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
    """(N, 3) uint8 colours of the pixels nearest to x (N, 2)."""
    w, h = image.size_wh
    c = x.round().long()
    return torch.from_numpy(
        np.ascontiguousarray(image.rgb[c[:, 1].clamp(0, h - 1), c[:, 0].clamp(0, w - 1)])
    )


def pose_errors(view: TwoView, R: np.ndarray, t: np.ndarray) -> dict[str, float]:
    """Degrees between the estimated and the true rotation, and between the directions of
    translation."""
    nan = float("nan")
    if view.R is None:
        return {"rotation_deg": nan, "translation_deg": nan}
    R_true, t_true = (torch.tensor(np.asarray(a), dtype=torch.float64) for a in (R, t))
    return {
        "rotation_deg": float(rotation_error(view.R, R_true)),
        "translation_deg": nan if view.t is None else float(translation_error(view.t, t_true)),
    }


def name_of(image: Image, number: int) -> str:
    """Name of an image in outputs."""
    return label(Path(image.path).name) if image.path else f"image{number}"
