"""Correspondences -> TwoView: a robust fit, its refinement, the pose, and the verdict on what the
scene shows."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

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
from ..types import Camera, Correspondences, Improvement, TwoView, Verdict
from . import opencv
from .plugins import run_estimator
from .result import RobustModel, supported
from .verdict import MIN_MATCHES, judge

# The search for a competing plane: a plane that matters is found in far fewer samples than a full
# search would take.
PLANE_ITERATIONS = 2_000


def undistorted_pixels(
    corr: Correspondences, camera1: Camera, camera2: Camera
) -> tuple[Tensor, Tensor]:
    """(N, 2) pixels in both images as ideal pinholes with the same K would have seen them."""
    return tuple(
        undistort_pixels(x, camera) for x, camera in ((corr.x1, camera1), (corr.x2, camera2))
    )  # type: ignore[return-value]


def within_the_field(corr: Correspondences, camera1: Camera, camera2: Camera) -> Correspondences:
    """Drop the correspondences outside the field that a camera's distortion describes.

    A distortion polynomial folds the image back beyond some radius; a point beyond it belongs to no
    ray. A warning counts the dropped ones.
    """
    valid = torch.ones(len(corr), dtype=torch.bool)
    for x, camera in ((corr.x1, camera1), (corr.x2, camera2)):
        valid &= undistort_pixels(x, camera, return_valid=True)[1]
    dropped = len(corr) - int(valid.sum())
    if not dropped:
        return corr
    warnings.warn(
        f"{dropped} of {len(corr)} correspondences lie outside the field that the distortion of "
        "the camera describes and were dropped; if they are many, check the distortion and its "
        "order (k1, k2, p1, p2, k3)",
        stacklevel=2,
    )
    return corr.take(valid)


def estimate_two_view(
    corr: Correspondences,
    camera1: Camera,
    camera2: Camera,
    options: EstimateOptions | None = None,
    *,
    seed: int = 0,
    device: Any = None,
) -> TwoView:
    """Estimate how camera 2 stands to camera 1, and judge whether the matches can tell.

    Args:
        corr: N correspondences in pixels of the photographs.
        options: model, back end and threshold.
        device: for estimators that take one.

    Returns:
        A :class:`TwoView`. Too few matches, or matches that agree no better than chance, are the
        verdict ``TOO_LITTLE`` without a pose; a pure rotation has R but no t.
    """
    options = options or EstimateOptions()
    x1, x2 = undistorted_pixels(corr, camera1, camera2)
    (K1, _), (K2, _) = camera1.tensors(), camera2.tensors()
    n = len(corr)
    nothing = torch.zeros(n, dtype=torch.bool)
    history: tuple[Improvement, ...] = ()

    def too_little(reason: str, evidence: dict[str, float]) -> TwoView:
        return TwoView(
            camera1, camera2, nothing, Verdict.TOO_LITTLE, reason, evidence, history=history
        )

    if n < MIN_MATCHES:
        return too_little(
            f"{n} matches; at least {MIN_MATCHES} are needed, and usually dozens. Try more operators or images that "
            "overlap more.",
            {"matches": n},
        )

    # Copies of a few matches must not pass for many: chance is judged by their number.
    fit = supported(
        robust_fit(x1, x2, K1, K2, corr, options, seed, device),
        x1,
        x2,
        MIN_MATCHES,
        options.threshold_px,
    )
    history = fit.history
    if fit.model is None:
        return too_little(
            f"No epipolar geometry was found that {MIN_MATCHES} different matches agree on, off one line.",
            {"matches": n, "inliers": 0},
        )
    calibrated = options.model == "essential"
    E = fit.model if calibrated else essential_from_fundamental(fit.model, K1, K2)
    R, t = pose_of(E, normalize(x1, K1), normalize(x2, K2), fit.inliers)
    if options.refine:
        R, t = refine_essential(R, t, x1[fit.inliers], x2[fit.inliers], K1, K2).pose
    E = essential_from_pose(R, t)
    if calibrated or options.refine:
        F = fundamental_from_essential(E, K1, K2)
        inliers = signed_sampson_distance(F, x1, x2).abs() < options.threshold_px
    # the paper's way: F and its inliers stand, and E is only derived from it, whatever it loses
    # thereby
    else:
        F, inliers = fit.model, fit.inliers

    plane = opencv.estimate(
        x1,
        x2,
        model="homography",
        threshold_px=options.threshold_px,
        seed=seed,
        max_iterations=PLANE_ITERATIONS,
    )
    # The competing explanations are compared at their best: a carelessly fitted F would lose to a
    # plane.
    F_best, inliers_best = F, inliers
    if not options.refine:
        F_best = fundamental_from_pose(
            *refine_essential(R, t, x1[inliers], x2[inliers], K1, K2).pose, K1, K2
        )
        inliers_best = signed_sampson_distance(F_best, x1, x2).abs() < options.threshold_px
    judgement = judge(x1, x2, K1, K2, F_best, inliers_best, plane.model, options.threshold_px, seed)
    if judgement.verdict is Verdict.TOO_LITTLE:
        return too_little(judgement.reason, judgement.evidence)
    if judgement.rotation is not None:
        return TwoView(
            camera1,
            camera2,
            plane.inliers,
            judgement.verdict,
            judgement.reason,
            judgement.evidence,
            R=judgement.rotation,
            H=plane.model,
            history=history,
        )
    alternatives: tuple[tuple[Tensor, Tensor], ...] = ()
    reason = judgement.reason
    if judgement.verdict is Verdict.PLANAR and plane.model is not None:
        (R, t), *others = planar_poses(
            plane.model, (R, t), x1, x2, K1, K2, inliers | plane.inliers, options.threshold_px
        )
        alternatives = tuple(others)
        E = essential_from_pose(R, t)
        F = fundamental_from_essential(E, K1, K2)
        inliers = signed_sampson_distance(F, x1, x2).abs() < options.threshold_px
        if alternatives:
            reason += (
                " A plane seen twice allows two motions; the other one is kept as an alternative."
            )
    in_front = cheirality(normalize(x1, K1), normalize(x2, K2), R, t)
    evidence = judgement.evidence | {"share_in_front": float(in_front[inliers].double().mean())}
    return TwoView(
        camera1,
        camera2,
        inliers & in_front,
        judgement.verdict,
        reason,
        evidence,
        R=R,
        t=t,
        E=E,
        F=F,
        H=plane.model,
        alternatives=alternatives,
        history=history,
    )


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
    """The poses under which the matches of a plane can have been seen, the best supported first.

    A homography decomposes into four poses, of which the plane lies in front of both cameras for
    one or two. They explain the plane alike; what lies off the plane, if anything, tells them
    apart, so each is refined on all inliers and they are ordered by their truncated squared Sampson
    distance. `start`, from the essential matrix, competes too.
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
        if float(cheirality(xn1[inliers], xn2[inliers], R, t).double().mean()) < 0.9:
            continue
        R, t = refine_essential(R, t, x1[inliers], x2[inliers], K1, K2).pose
        e = signed_sampson_distance(fundamental_from_pose(R, t, K1, K2), x1, x2)
        cost = float(e.square().clamp(max=threshold_px**2).sum())
        if all(float(rotation_error(R, Q) + translation_error(t, u)) > 0.5 for _, Q, u in seen):
            seen.append((cost, R, t))
    best = min((cost for cost, _, _ in seen), default=0.0)
    kept = [
        (R, t)
        for cost, R, t in sorted(seen, key=lambda s: s[0])
        if cost < 1.2 * best + threshold_px**2
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
    """E, or F where the options say so, by their estimator.

    The estimator gets the distance ratios of the matches and their operators; ours orders its
    samples by the former and learns the share of inliers of the latter.
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
    )
    if options.model == "fundamental":
        return refit_8point(fit, x1, x2, options.threshold_px)
    return fit


def refit_8point(fit: RobustModel, x1: Tensor, x2: Tensor, threshold_px: float) -> RobustModel:
    """The normalised eight-point F of all inliers, and its inliers: RANSAC's last step (Hartley &
    Zisserman, alg. 11.4).

    The best sample alone is a lottery over the order of the matches: it may pass every inlier test
    and still turn the translation by degrees.
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


def pose_of(E: Tensor, xn1: Tensor, xn2: Tensor, inliers: Tensor) -> tuple[Tensor, Tensor]:
    """(R, t) of the four that E allows that puts most inliers in front of both cameras."""
    R, t, _ = choose_pose(*decompose_essential(E), xn1[inliers], xn2[inliers])
    return R, t
