"""Starts for the estimation of unknown focal lengths: robust searches at several of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..geometry.coordinates import normalize
from ..geometry.essential import decompose_essential, project_to_essential
from ..geometry.focal import one_focal, shared_focal, two_focals
from ..geometry.focal_refinement import FreeFocal, focal_unknowns, refine_focal
from ..geometry.fundamental import fundamental_from_pose, squared_sampson_distance
from ..geometry.losses import marginal_score
from ..geometry.pose import choose_pose
from ..options import EstimateOptions
from ..types import Camera, Correspondences
from . import robust
from .result import RobustModel
from .two_view import undistorted_pixels

__all__ = ["FARTHEST", "best_start", "scaled_intrinsics", "squares"]

FARTHEST = math.log(5)  # from the prior, of the logarithm of a focal length
_SPREAD = (0.0, -1.2, 1.2)  # standard deviations from the prior at which E is searched
_SAMPLES = 1000  # of each search at most: with a wrong focal length the inliers are few
_MATCHES = 4096  # that the starts are refined on
_NARROWING = ((4.0, 10), (1.5, 20))  # thresholds, relative, and steps, as in the robust search


def best_start(
    corr: Correspondences,
    cameras: tuple[Camera, Camera],
    focal: FreeFocal,
    options: EstimateOptions,
    seed: int,
    device: Any,
) -> tuple[Tensor, Tensor, tuple[Camera, Camera]] | None:
    """Find a pose and focal lengths near the best explanation of the matches.

    Essential matrices are searched at the prior's focal lengths and at smaller and larger ones; a
    fundamental matrix is searched, and its focal lengths follow in closed form.
    All are refined jointly under the marginal loss, and the best by the marginal score is returned.

    Args:
        corr: N correspondences in pixels of the photographs.
        cameras: Cameras of the photographs with their prior focal lengths.
        focal: Unknown focal lengths.
        options: Threshold and confidence of the robust searches, which are those of the back end
            ``torch``.
        seed: Seed of all searches.
        device: Torch device, for estimators with such a parameter.

    Returns:
        Rotation, translation and cameras; None if no search finds a model.
    """
    x1, x2 = undistorted_pixels(corr, *cameras)
    (K1, _), (K2, _) = (camera.tensors() for camera in cameras)
    starts = list(_starts(x1, x2, K1, K2, corr, cameras, focal, options, seed, device))
    if not starts:
        return None
    R, t, scale = (torch.stack(parts) for parts in zip(*starts))
    order = torch.randperm(len(x1), generator=torch.Generator().manual_seed(seed))[:_MATCHES]
    y1, y2 = (x[order].expand(len(R), -1, -1) for x in (x1, x2))
    for width, steps in _NARROWING:
        found = refine_focal(
            R,
            t,
            y1,
            y2,
            K1,
            K2,
            scale=scale,
            focal=focal,
            loss="marginal",
            loss_scale=width * options.threshold_px,
            max_iterations=steps,
        )
        R, t, scale = found.R, found.t, found.scale
    score = marginal_score(squares(R, t, scale, y1, y2, K1, K2), options.threshold_px).sum(-1)
    score = score.nan_to_num(0.0).masked_fill(scale.log().abs().amax(-1) > FARTHEST, 0.0)
    best = int(score.argmax())
    if not float(score[best]) > 0:
        return None
    first, second = (
        replace(camera, K=scaled_intrinsics(K, scale[best, k]).numpy())
        for k, (camera, K) in enumerate(zip(cameras, (K1, K2)))
    )
    return R[best], t[best], (first, second)


def squares(
    R: Tensor, t: Tensor, scale: Tensor, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor
) -> Tensor:
    """Compute (*B, N) squared Sampson distances, square pixels, for focal factors (*B, 2)."""
    first, second = (scaled_intrinsics(K, scale[..., k]) for k, K in enumerate((K1, K2)))
    return squared_sampson_distance(fundamental_from_pose(R, t, first, second), x1, x2)


def scaled_intrinsics(K: Tensor, scale: Tensor) -> Tensor:
    """Multiply the focal lengths of intrinsics (3, 3) by factors (*B,)."""
    one = torch.ones_like(scale)
    rows = torch.stack((scale, scale, one), -1)
    return K * torch.stack((rows, rows, torch.ones_like(rows)), -2)


def _starts(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    corr: Correspondences,
    cameras: tuple[Camera, Camera],
    focal: FreeFocal,
    options: EstimateOptions,
    seed: int,
    device: Any,
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Poses and focal factors to refine from."""
    spread = torch.tensor([c.uncertainty.focal for c in cameras], dtype=x1.dtype)
    spread = spread * (focal_unknowns(focal, x1) != 0).any(1)
    search = partial(
        robust.estimate,
        threshold_px=options.threshold_px,
        confidence=options.confidence,
        max_iterations=min(options.max_iterations, _SAMPLES),
        seed=seed,
        ratio=corr.ratio,
        groups=corr.operator_id,
        device=device,
    )
    for step in _SPREAD:
        scale = (step * spread).exp()
        first, second = scaled_intrinsics(K1, scale[0]), scaled_intrinsics(K2, scale[1])
        fit = search(x1, x2, first, second)
        if fit.model is not None:
            yield *_pose(fit.model, fit, x1, x2, first, second), scale
    fit = search(x1, x2, model="fundamental")
    if fit.model is None:
        return
    for scale in _closed_form(K2.mT @ fit.model @ K1, focal):
        first, second = scaled_intrinsics(K1, scale[0]), scaled_intrinsics(K2, scale[1])
        E = project_to_essential(second.mT @ fit.model @ first)
        yield *_pose(E, fit, x1, x2, first, second), scale


def _pose(
    E: Tensor, fit: RobustModel, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor
) -> tuple[Tensor, Tensor]:
    xn1, xn2 = normalize(x1[fit.inliers], K1), normalize(x2[fit.inliers], K2)
    R, t, _ = choose_pose(*decompose_essential(E), xn1, xn2)
    return R, t


def _closed_form(M: Tensor, focal: FreeFocal) -> Iterator[Tensor]:
    """The focal factors (2,) that M determines and that are not far from the prior."""
    one = torch.ones((), dtype=M.dtype)
    if focal == "separate":
        s1, s2, valid = two_focals(M)
        candidates = [torch.stack((s1, s2))] if bool(valid) else []
    elif focal == "shared":
        s, valid = shared_focal(M)
        candidates = [torch.stack((v, v)) for v in s[valid]]
    else:
        s, valid = one_focal(M if focal == "second" else M.mT)
        pair = (one, s) if focal == "second" else (s, one)
        candidates = [torch.stack(pair)] if bool(valid) else []
    yield from (c for c in candidates if float(c.log().abs().max()) < FARTHEST)
