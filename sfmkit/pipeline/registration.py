"""Registration: the homography between two images, with per-operator statistics.

    >>> result = register("img1.png", "img2.png")
    >>> result.H, result.verdict, result.reason

A homography relates two images of a plane, or two images from the same position. Detection,
matching and fusion are those of :func:`sfmkit.reconstruct`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from .._utils.notices import collected
from .._utils.progress import Progress
from ..estimation.planar import PlanarFit, estimate_planar
from ..geometry.homography import squared_homography_sampson_distance, transfer
from ..geometry.homography_refinement import refine_homography
from ..io.images import read_image
from ..matching.fusion import fuse
from ..matching.guided import match_guided
from ..options import DEFAULT, FuseOptions, Options, PlanarOptions
from ..types import Correspondences, Matches, Verdict
from .account import OperatorAccount, make_account
from .stages import (
    OPERATORS_OF_THE_PAPER,
    FeaturePairs,
    ImageLike,
    Stopwatch,
    choose_options,
    detect_all,
    fuse_all,
    match_all,
)

_ROUNDS = 2  # maximum number of rounds of guided matching; the second starts from a better H
_SETTLED_PX = 0.5  # a round that moves every corner by less is the last one
_RADIUS = 2.0  # radius of guided matching around the predicted position, in thresholds
# descriptor distances up to this quantile of the operator's inliers are accepted
_DISTANCE_QUANTILE = 0.9
_WORST_RELATIVE = 1.35  # descriptor distance over its limit at which the weight would be 0
_LEAST_SIGMA_PX = 0.1  # lower bound of an operator's localisation error
_LEAST_DISTANCE = 1e-6  # lower bound of the limit of descriptor distances
_GRID = 8  # cells per side; matches in crowded cells get a smaller weight
# The weight of a match is n^-CROWD for n matches in its cell: with 0, all matches have the same
# weight; with 1, all cells have the same weight.
_CROWD = 0.5
_LEAST_INLIERS = 10  # minimum number of inliers to estimate the descriptor distances of an operator


@dataclass(frozen=True, eq=False)
class Registration:
    """The homography between two images, and the evidence for it.

    Attributes:
        H: (3, 3) float64, ``x2 = H x1`` in pixels, ``H[2, 2] = 1``; None for too little evidence.
        inliers: (N,) bool over `correspondences`.
        verdict: Planar, or too little evidence.
        reason: The verdict in words.
        evidence: The numbers on which it is based (:class:`~sfmkit.estimation.planar.PlanarFit`).
        correspondences: Fused matches of the whole images.
        guided: Result of guided matching, to which the final H is fitted; None without it.
        account: Statistics per operator and for all together (``multi``).
        timings_s: Seconds per stage.
        warnings: Messages about possible problems of the input or the result.
    """

    H: Tensor | None
    inliers: Tensor
    verdict: Verdict
    reason: str
    evidence: Mapping[str, float]
    correspondences: Correspondences
    guided: Correspondences | None
    account: Mapping[str, OperatorAccount]
    timings_s: Mapping[str, float]
    warnings: tuple[str, ...] = ()


def register(
    image1: ImageLike,
    image2: ImageLike,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    *,
    matchers: str | Mapping[str, str] | None = None,
    options: Options = DEFAULT,
    device: str | torch.device | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Registration:
    """Estimate the homography between two images.

    Args:
        image1, image2: Paths, (H, W, 3) uint8 RGB or (H, W) uint8 grey arrays, or :class:`Image`.
        operators: Names of operators, ``detector+descriptor``, or import paths of plug-ins.
        matchers: Name or import path of the matcher for all operators, or a mapping operator ->
            matcher for some; None for those of `options`.
        options: Options of detection, matching, fusion and the homography (``planar``).
        device: Torch device for detection and matching; None for that of `options`.
        seed: The same seed gives the same result on the same machine.
        progress: Callback for progress reports, called with (stage, detail).

    Returns:
        The homography and its evidence. If the images do not show one plane, no error is raised;
        the verdict reports it.

    Raises:
        InputError: An image, operator, matcher or device cannot be used.
    """
    watch = Stopwatch(progress)
    began = time.perf_counter()
    options = choose_options(options, operators, matchers=matchers, device=device, seed=seed)
    with collected() as warnings:
        with watch.stage("read", "images"):
            images = (read_image(image1), read_image(image2))
        with watch.stage("detect"):
            features = detect_all(images, operators, options.detect, watch, device=options.device)
        with watch.stage("match"):
            matches = match_all(features, options.match, watch, device=options.device)
        result = register_matches(features, matches, options=options, seed=seed, watch=watch)
    watch.seconds["total"] = time.perf_counter() - began
    return replace(result, timings_s=dict(watch.seconds), warnings=tuple(warnings))


def register_matches(
    features: FeaturePairs,
    matches: Mapping[str, Matches],
    *,
    options: Options = DEFAULT,
    seed: int = 0,
    watch: Stopwatch | None = None,
    fused: Correspondences | None = None,
) -> Registration:
    """Run :func:`register` from existing matches, or from existing fused correspondences."""
    watch = watch or Stopwatch()
    planar = options.planar
    with watch.stage("fuse", "matches of all operators"):
        corr = fuse_all(features, matches, options.fuse) if fused is None else fused
    with watch.stage("estimate", "homography"):
        fit = estimate_planar(corr, planar, seed=seed)
        guided = None
        if fit.H is not None and planar.guided:
            fit, guided = _guide(features, corr, fit, options.fuse, planar)
    return Registration(
        H=fit.H,
        inliers=fit.inliers,
        verdict=Verdict.TOO_LITTLE if fit.H is None else Verdict.PLANAR,
        reason=fit.reason,
        evidence=dict(fit.evidence),
        correspondences=corr,
        guided=guided,
        account=make_account(corr, fit.inliers, None),
        timings_s=dict(watch.seconds),
    )


def _guide(
    features: FeaturePairs,
    corr: Correspondences,
    fit: PlanarFit,
    options: FuseOptions,
    planar: PlanarOptions,
) -> tuple[PlanarFit, Correspondences | None]:
    """Improve the fit by guided matching; return it with the guided matches."""
    limits = {}
    for name in corr.operators:
        mine = corr.distance[
            fit.inliers & corr.found_by(name) & (corr.operator_id == corr.operators.index(name))
        ]
        if len(mine) >= _LEAST_INLIERS:
            # Distances are divided by the limit, so it must not be 0 even if most descriptors are
            # equal.
            limits[name] = max(float(torch.quantile(mine, _DISTANCE_QUANTILE)), _LEAST_DISTANCE)
    if not limits:
        return fit, None
    assert fit.H is not None
    H = fit.H
    w, h = next(iter(features.values()))[0].size_wh
    corners = torch.tensor([[0, 0], [w, 0], [w, h], [0, h]], dtype=torch.float64)
    for _ in range(_ROUNDS):
        found = {
            name: match_guided(
                *features[name],
                H.numpy(),
                radius_px=_RADIUS * planar.threshold_px,
                max_distance=limit,
            )
            for name, limit in limits.items()
        }
        guided = fuse(
            {name: (*features[name], m) for name, m in found.items()},
            merge_radius=options.merge_radius,
            cost={name: m.distance / np.float32(limits[name]) for name, m in found.items()},
        )
        if len(guided) < _LEAST_INLIERS:
            return fit, None
        before = H
        limit = torch.tensor([limits[name] for name in guided.operators], dtype=torch.float64)
        relative = guided.distance / limit[guided.operator_id]
        weights = localisation_weights(guided, H, relative)
        H = refine_homography(H, guided.x1, guided.x2, weights, threshold_px=planar.threshold_px)
        if (
            float((transfer(H, corners) - transfer(before, corners)).norm(dim=1).max())
            < _SETTLED_PX
        ):
            break
    inliers = squared_homography_sampson_distance(H, corr.x1, corr.x2) < planar.threshold_px**2
    return PlanarFit(H, inliers, fit.reason, fit.evidence), guided


def localisation_weights(guided: Correspondences, H: Tensor, relative: Tensor) -> Tensor:
    """Compute the weights of guided matches in the fit of the homography.

    Operators differ in precision: the weight is the inverse square of the operator's median
    distance to H. Within an operator, matches with similar descriptors are more precise. Many
    matches on one detail, which is rarely exactly in the plane, should not dominate: the weight of
    a match decreases with the number of matches in its grid cell.

    Args:
        guided: N matches.
        H: (3, 3).
        relative: (N,) descriptor distances divided by the limits of their operators, in [0, 1].

    Returns:
        (N,) weights with mean 1.
    """
    e = squared_homography_sampson_distance(H, guided.x1, guided.x2).sqrt()
    weight = _WORST_RELATIVE - relative
    for k in range(len(guided.operators)):
        mine = guided.operator_id == k
        if mine.any():
            weight[mine] /= e[mine].median().clamp(min=_LEAST_SIGMA_PX).square()
    low, high = guided.x1.amin(0), guided.x1.amax(0)
    cell = ((guided.x1 - low) / (high - low).clamp(min=1) * _GRID).long().clamp(max=_GRID - 1)
    cell = cell[:, 0] * _GRID + cell[:, 1]
    weight /= torch.bincount(cell)[cell].double() ** _CROWD
    return weight / weight.mean()
