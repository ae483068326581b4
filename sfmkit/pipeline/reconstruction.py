"""Reconstruction of a coloured point cloud from two photographs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from .._utils.notices import collected
from .._utils.progress import Progress
from ..estimation import within_the_field
from ..io.images import Image, read_image
from ..options import DEFAULT, Options
from ..types import Correspondences, Matches, PointCloud, TwoView, Verdict
from .account import OperatorAccount, make_account
from .provenance import used_plugins
from .stages import (
    OPERATORS_OF_THE_PAPER,
    CameraLike,
    FeaturePairs,
    ImageLike,
    Stopwatch,
    choose_cameras,
    choose_options,
    detect_all,
    estimate_geometry,
    fuse_all,
    make_cloud,
    match_all,
    pose_errors,
)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The results of all stages of a run.

    Attributes:
        images: The two photographs.
        features: Features of both images, per operator.
        matches: Matches before fusion, per operator.
        correspondences: Fused matches in pixels of the photographs (including their distortion).
        two_view: The geometry, its verdict and its inliers.
        cloud: Triangulated points; None if the geometry has no translation.
        account: Statistics per operator and for all together (``multi``).
        options, seed: Options and seed of the run.
        timings_s: Seconds per stage.
        warnings: Messages about possible problems of the input or the result.
        errors: Errors with respect to the truth, if given: ``rotation_deg``, ``translation_deg``.
        plugins: Provenance of each operator, matcher and estimator that was used.
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
    plugins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def trustworthy(self) -> bool:
        """Whether the geometry is reliable: neither too little evidence nor ambiguous."""
        return self.two_view.verdict not in (Verdict.TOO_LITTLE, Verdict.AMBIGUOUS)

    @property
    def reprojection_rmse_px(self) -> float | None:
        """Root mean square reprojection error of the cloud over both images, pixels."""
        if self.cloud is None or not len(self.cloud):
            return None
        return float(self.cloud.reprojection_error.square().mean().sqrt())


def reconstruct(
    image1: ImageLike,
    image2: ImageLike,
    camera: CameraLike | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    *,
    camera2: CameraLike | None = None,
    matchers: str | Mapping[str, str] | None = None,
    options: Options = DEFAULT,
    device: str | torch.device | None = None,
    seed: int = 0,
    truth: tuple[np.ndarray, np.ndarray] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a coloured point cloud from two overlapping photographs.

    Args:
        image1, image2: Paths, (H, W, 3) uint8 RGB or (H, W) uint8 grey arrays, or :class:`Image`.
        camera: Intrinsics of image 1, and of image 2 unless `camera2` is given: a :class:`Camera`,
            a (3, 3) K, or an argument of :func:`sfmkit.io.intrinsics.parse_intrinsics` (a file,
            ``fx,fy,cx,cy``); None reads them from EXIF.
        operators: Names of operators (``sfmkit operators`` lists them), ``detector+descriptor``,
            or import paths of plug-ins.
        camera2: Intrinsics of image 2, if it was taken by another camera.
        matchers: Name or import path of the matcher for all operators; or a mapping operator ->
            matcher for some of them, such as ``{"aliked": "lightglue"}``; None for those of
            `options`.
        options: :data:`sfmkit.options.DEFAULT`, another preset, or your own options.
        device: Torch device for detection, matching and the robust search, such as ``cuda``; None
            for that of `options`.
        seed: The same seed gives the same result on the same machine.
        truth: True pose (R, t), ``X2 = R X1 + t``, for the errors; t up to scale.
        progress: Callback for progress reports, called with (stage, detail).

    Returns:
        The results of all stages. If the matches do not support a geometry, no error is raised;
        the verdict of ``result.two_view`` reports it.

    Raises:
        InputError: An image, camera, operator, matcher, estimator or device cannot be used.
    """
    watch = Stopwatch(progress)
    began = time.perf_counter()
    options = choose_options(options, operators, matchers=matchers, device=device, seed=seed)
    with collected() as warnings:
        with watch.stage("read", "photographs and cameras"):
            images = (read_image(image1), read_image(image2))
            cameras = choose_cameras(images, camera, camera2)
        with watch.stage("detect"):
            features = detect_all(images, operators, options.detect, watch, device=options.device)
        with watch.stage("match"):
            matches = match_all(features, options.match, watch, device=options.device)
        with watch.stage("fuse", "matches of all operators"):
            corr = within_the_field(fuse_all(features, matches, options.fuse), *cameras)
        two_view, adjustment = estimate_geometry(
            corr, cameras, options.estimate, seed=seed, device=options.device, watch=watch
        )
        with watch.stage("triangulate", "points"):
            cloud = make_cloud(corr, two_view, images[0], options.triangulate, adjustment)
    watch.seconds["total"] = time.perf_counter() - began
    return Reconstruction(
        images=images,
        features=features,
        matches=matches,
        correspondences=corr,
        two_view=two_view,
        cloud=cloud,
        account=make_account(corr, two_view.inliers, cloud, two_view.witnesses),
        options=options,
        seed=seed,
        timings_s=dict(watch.seconds),
        warnings=tuple(warnings),
        errors=None if truth is None else pose_errors(two_view, *truth),
        plugins=used_plugins(tuple(features), options),
    )
