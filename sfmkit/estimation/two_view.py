"""Correspondences -> TwoView: robust fit, refinement, pose and verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from .._utils.notices import warn
from .._utils.threads import one_thread
from ..geometry.coordinates import normalize
from ..geometry.distortion import undistort_pixels
from ..geometry.essential import (
    decompose_essential,
    essential_from_fundamental,
    essential_from_pose,
)
from ..geometry.fundamental import (
    fundamental_8point,
    fundamental_from_essential,
    fundamental_from_pose,
    signed_sampson_distance,
)
from ..geometry.homography import decompose_homography
from ..geometry.pose import cheirality, choose_pose, rotation_error, translation_error
from ..geometry.refinement import refine_essential
from ..options import EstimateOptions
from ..types import Camera, Correspondences, TwoView, Verdict
from . import opencv
from .plugins import run_estimator
from .result import RobustModel, supported
from .scrutiny import scrutinise
from .verdict import MIN_MATCHES, assess

# Samples of the search for a competing plane. A plane that contains a quarter of the matches is
# missed with a probability of (1 - 0.25^4)^2000 = 0.0004.
PLANE_ITERATIONS = 2_000
# Poses of a plane. Not all inliers need to lie in front of both cameras, because noise moves some
# behind one. Poses whose rotations and translation directions together differ by less are one
# minimum. A cost above the ratio to the best one is evidence against a pose. Measured on 200 random
# planes with noise of 0.3 to 2 px (test_the_true_pose_of_a_plane_is_a_candidate): at least 0.9925
# of the inliers are in front at the true pose, its cost is at most 1.19 of the best one, and two
# minima are at least 0.68 degrees apart.
_LEAST_SHARE_IN_FRONT = 0.9
_SAME_POSE_DEG = 0.5
_COST_RATIO = 1.2


def undistorted_pixels(
    corr: Correspondences, camera1: Camera, camera2: Camera
) -> tuple[Tensor, Tensor]:
    """Remove the lens distortion from the pixels of both images; (N, 2) each."""
    return tuple(
        undistort_pixels(x, camera) for x, camera in ((corr.x1, camera1), (corr.x2, camera2))
    )  # type: ignore[return-value]


def within_the_field(corr: Correspondences, camera1: Camera, camera2: Camera) -> Correspondences:
    """Drop the correspondences outside the field that a camera's distortion describes.

    A distortion polynomial folds the image back beyond some radius; a point beyond it does not
    correspond to a ray. A warning states how many were dropped.
    """
    valid = torch.ones(len(corr), dtype=torch.bool)
    for x, camera in ((corr.x1, camera1), (corr.x2, camera2)):
        valid &= undistort_pixels(x, camera, return_valid=True)[1]
    dropped = len(corr) - int(valid.sum())
    if not dropped:
        return corr
    warn(
        f"{dropped} of {len(corr)} correspondences lie outside the field that the distortion of "
        "the camera describes and were dropped; if they are many, check the distortion and its "
        "order (k1, k2, p1, p2, k3)",
        stacklevel=2,
    )
    return corr.take(valid)


@one_thread()
def estimate_two_view(
    corr: Correspondences,
    camera1: Camera,
    camera2: Camera,
    options: EstimateOptions | None = None,
    *,
    seed: int = 0,
    device: Any = None,
) -> TwoView:
    """Estimate the pose of camera 2 relative to camera 1 and assess the evidence for it.

    Args:
        corr: N correspondences in pixels of the photographs.
        camera1, camera2: Cameras of the photographs.
        options: Model, back end and threshold.
        seed: The same seed gives the same result on the same machine.
        device: Torch device, for estimators with such a parameter.

    Returns:
        A :class:`TwoView`. The verdict ``TOO_LITTLE``, without a pose, is returned for too few
        matches, for matches that agree no better than chance, for mirrored photographs and where
        operators or halves of the image contradict each other; a pure rotation has R but no t. The
        verdict ``AMBIGUOUS`` comes with the rival motion in ``alternatives``.
    """
    options = options or EstimateOptions()
    n = len(corr)
    if n < MIN_MATCHES:
        reason = (
            f"{n} matches; at least {MIN_MATCHES} are needed, and usually dozens. Try more "
            "operators, or images that overlap more."
        )
        return _too_little(camera1, camera2, n, reason, {"matches": n})
    x1, x2 = undistorted_pixels(corr, camera1, camera2)
    (K1, _), (K2, _) = camera1.tensors(), camera2.tensors()
    fit = robust_fit(x1, x2, K1, K2, corr, options, seed, device)
    # log10_nfa counts matches, so duplicates of a few matches must not count as many.
    fit = supported(fit, x1, x2, MIN_MATCHES, options.threshold_px)
    if fit.model is None:
        reason = (
            f"No epipolar geometry was found that {MIN_MATCHES} different matches, not all on one "
            "line, agree on."
        )
        return _too_little(camera1, camera2, n, reason, {"matches": n, "inliers": 0}, fit)
    pose = pose_from_fit(fit, x1, x2, K1, K2, options)
    plane = opencv.estimate(
        x1,
        x2,
        model="homography",
        threshold_px=options.threshold_px,
        seed=seed,
        max_iterations=PLANE_ITERATIONS,
    )
    best = pose if options.refine else _refined(pose, x1, x2, K1, K2, options.threshold_px)
    found = assess(x1, x2, K1, K2, best.F, best.inliers, plane.model, options.threshold_px, seed)
    if found.verdict is Verdict.TOO_LITTLE:
        return _too_little(camera1, camera2, n, found.reason, found.evidence, fit)
    doubts = scrutinise(
        best.R,
        best.t,
        best.F,
        best.inliers,
        corr,
        x1,
        x2,
        K1,
        K2,
        camera1.size_wh,
        options.threshold_px,
        seed,
    )
    evidence = found.evidence | doubts.evidence
    witnesses = {name: witness.log10_p for name, witness in doubts.witnesses.items()}
    if doubts.verdict is Verdict.TOO_LITTLE:
        refused = _too_little(camera1, camera2, n, doubts.reason, evidence, fit)
        return replace(refused, witnesses=witnesses)
    rivals = ((doubts.rival.R, doubts.rival.t),) if doubts.verdict and doubts.rival else ()
    verdict, reason = doubts.verdict or found.verdict, doubts.reason or found.reason
    if found.rotation is not None:
        return TwoView(
            camera1,
            camera2,
            plane.inliers,
            verdict,
            reason,
            evidence,
            R=found.rotation,
            H=plane.model,
            alternatives=rivals,
            witnesses=witnesses,
            history=fit.history,
        )
    alternatives: tuple[tuple[Tensor, Tensor], ...] = ()
    if found.verdict is Verdict.PLANAR and plane.model is not None:
        support = pose.inliers | plane.inliers
        (R, t), *others = planar_poses(
            plane.model, (pose.R, pose.t), x1, x2, K1, K2, support, options.threshold_px
        )
        pose, alternatives = _pose(R, t, x1, x2, K1, K2, options.threshold_px), tuple(others)
        if alternatives:
            reason += " A plane seen twice allows two motions; the other is kept as an alternative."
    in_front = cheirality(normalize(x1, K1), normalize(x2, K2), pose.R, pose.t)
    share = float(in_front[pose.inliers].double().mean())
    return TwoView(
        camera1,
        camera2,
        pose.inliers & in_front,
        verdict,
        reason,
        evidence | {"share_in_front": share},
        R=pose.R,
        t=pose.t,
        E=pose.E,
        F=pose.F,
        H=plane.model,
        alternatives=(*alternatives, *rivals),
        witnesses=witnesses,
        history=fit.history,
    )


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose with its matrices and its inliers.

    Attributes:
        R, t: (3, 3) and (3,), t of unit length.
        E, F: (3, 3) essential and fundamental matrix.
        inliers: (N,) bool, the matches that agree with F.
    """

    R: Tensor
    t: Tensor
    E: Tensor
    F: Tensor
    inliers: Tensor


def pose_from_fit(
    fit: RobustModel, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, options: EstimateOptions
) -> Pose:
    """Compute the pose of a robustly estimated E or F, and refine it if the options say so.

    Without refinement, a fitted F and its inliers are kept unchanged (the paper's procedure). E is
    derived from F by projection, so its epipolar geometry then differs from that of F.

    Args:
        fit: The robust fit; its model must not be None.
        x1, x2: (N, 2) undistorted pixels.
    """
    assert fit.model is not None
    calibrated = options.model == "essential"
    E = fit.model if calibrated else essential_from_fundamental(fit.model, K1, K2)
    xn1, xn2 = normalize(x1, K1), normalize(x2, K2)
    R, t, _ = choose_pose(*decompose_essential(E), xn1[fit.inliers], xn2[fit.inliers])
    if options.refine:
        R, t = refine_essential(R, t, x1[fit.inliers], x2[fit.inliers], K1, K2).pose
    pose = _pose(R, t, x1, x2, K1, K2, options.threshold_px)
    if calibrated or options.refine:
        return pose
    return replace(pose, F=fit.model, inliers=fit.inliers)


def _pose(
    R: Tensor, t: Tensor, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, threshold_px: float
) -> Pose:
    E = essential_from_pose(R, t)
    F = fundamental_from_essential(E, K1, K2)
    return Pose(R, t, E, F, signed_sampson_distance(F, x1, x2).abs() < threshold_px)


def _refined(
    pose: Pose, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, threshold_px: float
) -> Pose:
    """Refine the pose on its inliers before a plane is compared with it.

    An unrefined F has larger residuals than a plane fitted to the same matches.
    """
    R, t = refine_essential(pose.R, pose.t, x1[pose.inliers], x2[pose.inliers], K1, K2).pose
    return _pose(R, t, x1, x2, K1, K2, threshold_px)


def _too_little(
    camera1: Camera,
    camera2: Camera,
    n: int,
    reason: str,
    evidence: dict[str, float],
    fit: RobustModel | None = None,
) -> TwoView:
    nothing = torch.zeros(n, dtype=torch.bool)
    history = () if fit is None else fit.history
    return TwoView(camera1, camera2, nothing, Verdict.TOO_LITTLE, reason, evidence, history=history)


def planar_poses(
    H: Tensor,
    start: tuple[Tensor, Tensor],
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    inliers: Tensor,
    threshold_px: float,
) -> list[tuple[Tensor, Tensor]]:
    """Find the poses that explain the matches of a plane, the best supported first.

    A homography decomposes into four poses; for one or two of them the plane lies in front of both
    cameras. These explain the plane equally well and differ only in points off the plane, so each
    is refined on all inliers, and they are ordered by the truncated squared Sampson distance.

    Args:
        H: (3, 3) homography of the plane, pixels.
        start: Pose from the essential matrix, a further candidate.
        x1, x2: (N, 2) undistorted pixels.
        inliers: (N,) bool, of the plane or of `start`.
        threshold_px: Limit of the truncated distance.

    Returns:
        (R, t) of every candidate whose cost is close to the smallest one; `start` if none is left.
    """
    xn1, xn2 = normalize(x1, K1), normalize(x2, K2)
    Rs, ts, _ = decompose_homography(H, K1, K2)
    candidates = [
        start,
        *(
            (R, torch.nn.functional.normalize(t, dim=0))
            for R, t in zip(Rs, ts)
            if float(t.norm()) > 0
        ),
    ]
    seen: list[tuple[float, Tensor, Tensor]] = []
    for R, t in candidates:
        if (
            float(cheirality(xn1[inliers], xn2[inliers], R, t).double().mean())
            < _LEAST_SHARE_IN_FRONT
        ):
            continue
        R, t = refine_essential(R, t, x1[inliers], x2[inliers], K1, K2).pose
        e = signed_sampson_distance(fundamental_from_pose(R, t, K1, K2), x1, x2)
        cost = float(e.square().clamp(max=threshold_px**2).sum())
        distances = [float(rotation_error(R, Q) + translation_error(t, u)) for _, Q, u in seen]
        if all(distance > _SAME_POSE_DEG for distance in distances):
            seen.append((cost, R, t))
    best = min((cost for cost, _, _ in seen), default=0.0)
    kept = [
        (R, t)
        for cost, R, t in sorted(seen, key=lambda s: s[0])
        if cost < _COST_RATIO * best + threshold_px**2
    ]
    return kept or [start]


def robust_fit(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    corr: Correspondences,
    options: EstimateOptions,
    seed: int,
    device: Any = None,
) -> RobustModel:
    """Estimate E, or F if the options say so, with the estimator of the options.

    The estimator gets the distance ratios of the matches and their operators. The built-in one
    orders its samples by the ratios and estimates the inlier rate of each operator.
    """
    fit = run_estimator(
        options.backend,
        x1,
        x2,
        K1,
        K2,
        model=options.model,
        method=options.method,
        threshold_px=options.threshold_px,
        confidence=options.confidence,
        max_iterations=options.max_iterations,
        seed=seed,
        ratio=corr.ratio,
        groups=corr.operator_id,
        device=device,
        overrides=options.overrides,
    )
    if options.model == "fundamental":
        return refit_8point(fit, x1, x2, options.threshold_px)
    return fit


def refit_8point(fit: RobustModel, x1: Tensor, x2: Tensor, threshold_px: float) -> RobustModel:
    """Fit F to all inliers with the normalised eight-point algorithm, the last step of RANSAC.

    The model of the best sample depends on the order of the matches: even if all inliers agree
    with it, the direction of its translation can be wrong by degrees.

    Source: Hartley and Zisserman, 2nd ed., algorithm 11.4.
    """
    if fit.model is None or int(fit.inliers.sum()) < MIN_MATCHES:
        return fit
    F, inliers = fit.model, fit.inliers
    for _ in range(2):
        F = fundamental_8point(x1[inliers], x2[inliers])
        inliers = signed_sampson_distance(F, x1, x2).abs() < threshold_px
    if int(inliers.sum()) < int(fit.inliers.sum()) // 2:
        return fit
    return replace(fit, model=F, inliers=inliers)
