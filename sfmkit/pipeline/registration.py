"""Two images of a plane, or from one place, to the homography between them, with an account of the
operators' shares.

    >>> result = register("img1.png", "img2.png")
    >>> result.H, result.verdict, result.reason

The homography's counterpart of :func:`sfmkit.reconstruct`; detection, matching and fusion are the
same.
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

_ROUNDS = 2  # of guided matching at most: the second starts from a better homography
_SETTLED_PX = 0.5  # a round that moves no corner farther is the last
_RADIUS = 2.0  # guided matching looks this many thresholds around the predicted position
_DISTANCE_QUANTILE = (
    0.9  # descriptor distances up to this quantile of the operator's inliers are accepted
)
_WORST_RELATIVE = 1.35  # descriptor distance over its limit at which a match would not count
_LEAST_SIGMA_PX = 0.1  # no operator localises better
_LEAST_DISTANCE = 1e-6  # between descriptors that differ; rounding is larger
_GRID = 8  # cells a side, in which a crowd of matches is thinned by weight
# a match counts by the number in its cell to the power of minus this: 0 counts each alike, 1 each
# cell
_CROWD = 0.5
_LEAST_INLIERS = 10  # of an operator, to know its descriptor distances


@dataclass(frozen=True, eq=False)
class Registration:
    """How image 2 lies on image 1, and what that rests on.

    Attributes:
        H: (3, 3) float64, ``x2 = H x1`` in pixels, ``H[2, 2] = 1``; None for too little evidence.
        inliers: (N,) bool over `correspondences`.
        verdict: planar, or too little evidence.
        reason: the verdict in words.
        evidence: the numbers that it rests on (:class:`~sfmkit.estimation.planar.PlanarFit`).
        correspondences: fused, of the whole images.
        guided: matched again under the homography; what the final H is fitted to. None where that
            was not done.
        account: per operator and for all, what went in and agreed.
        timings_s: seconds per stage.
        warnings: messages about what may be wrong with the input or the result.
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
    """The homography between two images.

    Args:
        image1, image2: paths, (H, W, 3) uint8 RGB or (H, W) uint8 grey arrays, or :class:`Image`.
        operators: names of operators, ``detector+descriptor``, or import paths of plug-ins.
        matchers: name or import path of the matcher of all operators; or operator -> matcher for
            some of them; None for those of `options`.
        options: of detection, matching, fusion and the homography (``planar``).
        device: torch device of detection and matching; None for that of `options`.
        seed: the same seed gives the same result on the same machine.
        progress: called with (stage, detail).

    Raises:
        InputError: images and operators that cannot be used. Images that do not show one plane are
            not an error: they are the verdict.
    """
    watch = Stopwatch(progress)
    began = time.perf_counter()
    options = choose_options(options, operators, matchers=matchers, device=device)
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
    """:func:`register` from the matches on, or from what they were fused to, for those who have
    them already."""
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
    """The fit improved on matches that were looked for under it, and those matches."""
    limits = {}
    for name in corr.operators:
        mine = corr.distance[
            fit.inliers & corr.found_by(name) & (corr.operator_id == corr.operators.index(name))
        ]
        if len(mine) >= _LEAST_INLIERS:
            # Not 0, where most descriptors are equal: distances are divided by it.
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

    Operators differ in precision: each counts by the inverse square of its median distance to H.
    Within an operator, positions agree better where descriptors do. Many matches on one detail,
    which is rarely exactly in the plane, should not decide for the whole image: the more matches in
    a cell of a grid, the less each counts.

    Args:
        guided: N matches.
        H: (3, 3).
        relative: (N,) descriptor distance over the limit of its operator, in [0, 1].

    Returns:
        (N,) of mean 1.
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
