"""Estimation of unknown focal lengths from the matches of a pair.

From the best start of :mod:`.focal_search`, pose and focal length are refined on the inliers, and
the first radial distortion coefficient k1, which acts like a change of the focal length towards the
edge of the image, is estimated with them. The focal length that a camera came with, from EXIF or a
guess, is a prior: prior and matches are combined by their covariances, and where the matches know
less than the prior, the camera stays as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .._utils.notices import warn
from .._utils.threads import one_thread
from ..errors import DegenerateGeometryError
from ..geometry.block_covariance import (
    camera_covariance,
    image_blocks,
    jackknife_covariance,
    linearise_pose,
)
from ..geometry.focal_refinement import FreeFocal, focal_unknowns, refine_focal
from ..options import EstimateOptions
from ..types import Camera, Correspondences, IntrinsicsSigma, TwoView, Verdict
from .focal_search import FARTHEST, best_start, scaled_intrinsics, squares
from .pose_uncertainty import intrinsics_sigmas
from .two_view import estimate_two_view, undistorted_pixels

__all__ = ["FocalEstimate", "estimate_focal", "estimate_with_focal", "unknown_focal"]

# Relative standard deviation from which a focal length is estimated: a guess (30 %), or sources in
# EXIF that disagree by more than 20 %. Matches seldom know more than the 3 to 5 % of other EXIF: on
# drone photographs, whose axes are parallel, they change it by 11 %, away from the nominal value.
UNCERTAIN = 0.1
_LEAST_MATCHES = 16
_MOST_MATCHES = 8000  # a random part of more: errors that regions share do not shrink with more
_ROUNDS = 5  # of refinement: k1 enters linearly, and changes which matches agree


@dataclass(frozen=True, eq=False)
class FocalEstimate:
    """What the matches determine of the unknown focal lengths of a pair.

    Attributes:
        cameras: Both cameras, with the estimated focal lengths and k1 and their standard
            deviations; unchanged where the matches do not determine them.
        focal: Which focal lengths were unknown.
        determined: Whether the cameras have estimated focal lengths.
        sigma: Relative standard deviation of the focal length from the matches alone, without its
            prior; infinite where there is none.
        reason: The result in words.
    """

    cameras: tuple[Camera, Camera]
    focal: FreeFocal
    determined: bool
    sigma: float
    reason: str


def unknown_focal(camera1: Camera, camera2: Camera) -> FreeFocal | None:
    """Return which focal lengths are unknown, None where both are known.

    Two cameras with one uncertain focal length and images of one size, upright or turned, are
    treated as one camera. Only cameras of the distortion model ``opencv`` are estimated.
    """
    first, second = (
        c.model == "opencv" and c.uncertainty.focal >= UNCERTAIN for c in (camera1, camera2)
    )
    if not (first and second):
        return "first" if first else "second" if second else None
    same_size = sorted(camera1.size_wh) == sorted(camera2.size_wh)
    same_focal = math.isclose(camera1.K[0, 0], camera2.K[0, 0], rel_tol=1e-3)
    return "shared" if same_size and same_focal else "separate"


@one_thread()
def estimate_focal(
    corr: Correspondences,
    camera1: Camera,
    camera2: Camera,
    options: EstimateOptions | None = None,
    *,
    seed: int = 0,
    device: Any = None,
) -> FocalEstimate | None:
    """Estimate the focal lengths that are unknown.

    The matches do not determine a focal length if the optical axes are parallel or, for one focal
    length of both images, meet at equal distances from the cameras. Then its standard deviation
    exceeds that of the prior. A plane does not determine it either, but wrong matches that agree by
    chance can seem to; :func:`estimate_with_focal` recognises planes.

    Args:
        corr: N correspondences in pixels of the photographs.
        camera1, camera2: Cameras of the photographs; their uncertainty decides which focal lengths
            are estimated (:func:`unknown_focal`).
        options: Threshold and confidence of the robust searches.
        seed: The same seed gives the same result on the same machine.
        device: Torch device of the robust searches.

    Returns:
        The estimate; None where both focal lengths are known.
    """
    options = options or EstimateOptions()
    focal = unknown_focal(camera1, camera2)
    if focal is None:
        return None
    priors = camera1, camera2
    if len(corr) < _LEAST_MATCHES:
        return _undetermined(priors, focal, f"{len(corr)} matches are too few")
    if len(corr) > _MOST_MATCHES:
        order = torch.randperm(len(corr), generator=torch.Generator().manual_seed(seed))
        corr = corr.take(order[:_MOST_MATCHES].sort().values)
    start = best_start(corr, priors, focal, options, seed, device)
    if start is None:
        return _undetermined(priors, focal, "no search ended at a possible focal length")
    R, t, cameras = start
    before = max(c.uncertainty.focal for c, free in zip(priors, _free(focal)) if free)
    sigma = 0.0
    for _ in range(_ROUNDS):
        try:
            measured = _measure(corr, R, t, priors, cameras, focal, options.threshold_px)
            cameras, sigma = _combine(measured, priors, focal)
        except DegenerateGeometryError as error:
            return _undetermined(priors, focal, str(error))
        if not sigma < before:  # in any round: along a flat valley it may look smaller later
            percent = "more than 100 %" if sigma > 1 else f"{100 * sigma:.0f} %"
            why = f"its standard deviation would be {percent} instead of {100 * before:.0f} %"
            return _undetermined(priors, focal, why, sigma)
        R, t = measured.R, measured.t
    return FocalEstimate(cameras, focal, True, sigma, _words(cameras, focal))


def estimate_with_focal(
    corr: Correspondences,
    camera1: Camera,
    camera2: Camera,
    options: EstimateOptions | None = None,
    *,
    seed: int = 0,
    device: Any = None,
) -> TwoView:
    """Estimate the geometry of two views after the focal lengths that are unknown.

    The cameras of the result have the estimated focal lengths. Where the verdict is a plane or too
    little evidence, the matches determine no focal length, and the estimation is repeated with the
    cameras as they were. A warning says where a guessed focal length stays.

    Args:
        corr, camera1, camera2, options, seed, device: See
            :func:`sfmkit.estimation.estimate_two_view`; with ``options.focal == "fixed"`` this
            function does the same.
    """
    options = options or EstimateOptions()
    priors = camera1, camera2
    found = None
    if options.focal == "estimate":
        found = estimate_focal(corr, *priors, options, seed=seed, device=device)
    cameras = priors if found is None else found.cameras
    view = estimate_two_view(corr, *cameras, options, seed=seed, device=device)
    if found is None:
        return view
    reason = found.reason
    if found.determined and view.verdict in (Verdict.PLANAR, Verdict.TOO_LITTLE):
        reason = _undetermined(priors, found.focal, f"the verdict is {view.verdict.value}").reason
        view = estimate_two_view(corr, *priors, options, seed=seed, device=device)
    elif found.determined:
        return view
    if view.R is not None and any(camera.source == "guessed" for camera in priors):
        warn(reason, stacklevel=2)
    return view


def _undetermined(
    priors: tuple[Camera, Camera], focal: FreeFocal, why: str, sigma: float = math.inf
) -> FocalEstimate:
    kept = dict.fromkeys(
        f"{c.K[0, 0]:.0f} px ({c.source})" for c, free in zip(priors, _free(focal)) if free
    )
    reason = (
        f"the matches do not determine the focal length: {why}. Kept: {' and '.join(kept)}; the "
        "pose is as wrong as this focal length"
    )
    return FocalEstimate(priors, focal, False, sigma, reason)


def _words(cameras: tuple[Camera, Camera], focal: FreeFocal) -> str:
    lengths = dict.fromkeys(
        f"{c.K[0, 0]:.0f} px with a standard deviation of {100 * c.uncertainty.focal:.1f} %"
        for c, free in zip(cameras, _free(focal))
        if free
    )
    what = "one focal length for both images" if focal == "shared" else "the focal length"
    return f"{what} was estimated from the matches: {' and '.join(lengths)}"


def _free(focal: FreeFocal) -> tuple[bool, bool]:
    """Return which cameras are estimated."""
    return focal != "second", focal != "first"


@dataclass(frozen=True, eq=False)
class _Measured:
    """What the matches alone say.

    Attributes:
        R, t: (3, 3) and (3,) pose.
        x: (2k,) logarithms of k focal factors, then k changes of k1, with respect to the priors.
        regions: (2k, 2k) covariance of x by errors that the matches of an image region share.
        points: (2k, 2k) covariance of x by errors of the intrinsics that are not estimated.
    """

    R: Tensor
    t: Tensor
    x: Tensor
    regions: Tensor
    points: Tensor


def _measure(
    corr: Correspondences,
    R: Tensor,
    t: Tensor,
    priors: tuple[Camera, Camera],
    cameras: tuple[Camera, Camera],
    focal: FreeFocal,
    threshold_px: float,
) -> _Measured:
    """Refine pose and focal lengths on the inliers, and take one step towards k1.

    Raises:
        DegenerateGeometryError: The inliers are too few or do not determine the unknowns.
    """
    x1, x2 = undistorted_pixels(corr, *cameras)
    (K1, _), (K2, _) = (camera.tensors() for camera in cameras)
    inliers = squares(R, t, torch.ones_like(t[:2]), x1, x2, K1, K2) < threshold_px**2
    if int(inliers.sum()) < _LEAST_MATCHES:
        raise DegenerateGeometryError(f"only {int(inliers.sum())} matches agree")
    x1, x2 = x1[inliers], x2[inliers]
    found = refine_focal(R, t, x1, x2, K1, K2, focal=focal)
    K1, K2 = (scaled_intrinsics(K, found.scale[k]) for k, K in enumerate((K1, K2)))
    sensitivity = linearise_pose(found.R, found.t, x1, x2, K1, K2, focal=focal)
    step = -torch.linalg.solve(sensitivity.hessian.sum(0), sensitivity.score.sum(0))[5:]
    regions = jackknife_covariance(sensitivity, image_blocks(x1, cameras[0].size_wh))[5:, 5:]
    sigma1, sigma2 = (intrinsics_sigmas(camera) for camera in priors)
    points = camera_covariance(sensitivity, sigma1, sigma2, focal == "shared")[5:, 5:]
    moved = torch.tensor(
        [math.log(c.K[0, 0] / p.K[0, 0]) for c, p in zip(cameras, priors)]
        + [c.distortion[0] - p.distortion[0] for c, p in zip(cameras, priors)],
        dtype=step.dtype,
    )
    moved = moved + torch.nn.functional.pad(found.scale.log(), (0, 2))
    return _Measured(found.R, found.t, _pick(focal) @ moved + step, regions, points)


def _combine(
    measured: _Measured, priors: tuple[Camera, Camera], focal: FreeFocal
) -> tuple[tuple[Camera, Camera], float]:
    """Combine what the matches say with the priors.

    With the covariance C of the matches' x and the precision P of the prior, which is around zero,
    x has the covariance ``(C^-1 + P)^-1`` and the mean ``(C^-1 + P)^-1 C^-1 x``. The principal
    point is not estimated: its error adds to the covariance only.

    Returns:
        The cameras, and the standard deviation of the least certain focal length without its prior.

    Raises:
        DegenerateGeometryError: The matches determine no focal length.
    """
    if not bool(torch.isfinite(measured.regions).all()):
        raise DegenerateGeometryError("they cover too little of the image")
    sigmas = torch.tensor(
        [p.uncertainty.focal for p in priors] + [p.uncertainty.k1 for p in priors],
        dtype=measured.x.dtype,
    )
    precision = (_pick(focal) @ sigmas).square().reciprocal()
    information = torch.linalg.inv(measured.regions)
    covariance = torch.linalg.inv(information + torch.diag(precision))
    x = covariance @ (information @ measured.x)
    precision[: len(x) // 2] = 0
    alone = torch.linalg.inv(information + torch.diag(precision)) + measured.points
    sigma = float(alone.diagonal()[: len(x) // 2].clamp(min=0).max().sqrt())
    if not (math.isfinite(sigma) and bool((x[: len(x) // 2].abs() < FARTHEST).all())):
        raise DegenerateGeometryError("all focal lengths explain them equally well")
    maps = _maps(focal)
    by_camera = maps @ x
    deviations = (maps @ (covariance + measured.points) @ maps.mT).diagonal().clamp(min=0).sqrt()
    first, second = (
        _estimated(p, by_camera[k::2].tolist(), deviations[k::2].tolist()) if free else p
        for k, (p, free) in enumerate(zip(priors, _free(focal)))
    )
    return (first, second), sigma


def _maps(focal: FreeFocal) -> Tensor:
    """Return the matrix (4, 2k) from x to both log factors and both changes of k1."""
    unknowns = focal_unknowns(focal, torch.zeros((), dtype=torch.float64))
    return torch.block_diag(unknowns, unknowns)


def _pick(focal: FreeFocal) -> Tensor:
    """Return the matrix (2k, 4) back, which takes the mean of what the cameras share."""
    maps = _maps(focal)
    return maps.mT / maps.sum(0)[:, None]


def _estimated(prior: Camera, change: list[float], sigma: list[float]) -> Camera:
    """Return the prior's camera after a change of the log focal length and of k1."""
    K, distortion = np.array(prior.K), np.array(prior.distortion)
    K[:2, :2] *= math.exp(change[0])
    distortion[0] += change[1]
    return replace(
        prior,
        K=K,
        distortion=distortion,
        source=f"estimated, from {prior.source}",
        sigma=IntrinsicsSigma(sigma[0], prior.uncertainty.principal_point, sigma[1]),
    )
