"""What the correspondences show: depth, a plane, a pure rotation, or too little evidence.

Whether there is anything to explain is decided first, a contrario (Moisan & Stival, IJCV 2004): how
many models as good as this one would chance alone produce among this many matches?

The competing explanations are then compared by Torr's geometric robust information criterion
(GRIC): a squared residual counts up to a limit, and a model pays for its dimension and its
parameters. Without that price the essential matrix, which fits everything that a homography fits,
would always win. All residuals are first-order geometric (Sampson) distances in the joint image
space of both views, in pixels, so they are comparable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..geometry.coordinates import denormalize, normalize, to_homogeneous
from ..geometry.fundamental import squared_sampson_distance
from ..geometry.homography import squared_homography_sampson_distance
from ..types import Verdict
from .chance import MAX_LOG10_NFA, chance_agreement, log10_nfa
from .handedness import Handedness, handedness

MIN_MATCHES = 8
# Detectors localise to 0.1 px at best; without this least value the criterion would compare
# rounding errors on exact synthetic data.
MIN_SIGMA_PX = 0.1


@dataclass(frozen=True)
class Assessment:
    """A verdict on an estimated geometry.

    Attributes:
        verdict: What the matches show.
        reason: The verdict in words.
        evidence: The numbers that it rests on.
        rotation: (3, 3) where the verdict is a pure rotation, else None.
    """

    verdict: Verdict
    reason: str
    evidence: dict[str, float]
    rotation: Tensor | None = None


def fit_rotation(
    x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, R0: Tensor, scale_px: float
) -> Tensor:
    """Fit the rotation that turns the rays of x1 into those of x2, robustly.

    Iteratively reweighted Kabsch (Arun et al. 1987) with Cauchy weights at `scale_px`,
    from `R0`.
    """
    f1, f2 = (
        torch.nn.functional.normalize(to_homogeneous(normalize(x, K)), dim=-1)
        for x, K in ((x1, K1), (x2, K2))
    )
    R = R0
    for _ in range(20):
        e2 = ((rotate_pixels(R, x1, K1, K2) - x2) ** 2).sum(-1) / scale_px**2
        w = 1 / (1 + e2)
        U, _, Vt = torch.linalg.svd((w[:, None] * f2).mT @ f1)
        U = torch.cat((U[:, :2], U[:, 2:] * torch.det(U @ Vt)), 1)
        step, R = (U @ Vt) @ R.mT, U @ Vt
        if (step.diagonal().sum() - 3).abs() < 1e-14:
            break
    return R


def rotate_pixels(R: Tensor, x1: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Map pixels of image 1 to image 2 by a rotation, as points at infinity move; (N, 2)."""
    y = to_homogeneous(normalize(x1, K1)) @ R.mT
    return denormalize(y[:, :2] / y[:, 2:], K2)


def gric(squared: Tensor, sigma: float, dimension: int, parameters: int) -> float:
    """Compute Torr's criterion of N squared residuals (square pixels); smaller is better.

    Args:
        dimension: of the manifold in the 4-space of a correspondence: 3 for E and F, 2 for H and
            rotations.
        parameters: degrees of freedom of the model.

    Source: Torr, "An assessment of information criteria for motion model selection", CVPR 1997.
    """
    n, r = len(squared), 4
    rho = torch.clamp(squared / sigma**2, max=2.0 * (r - dimension)).sum()
    return float(rho) + math.log(r) * dimension * n + math.log(r * n) * parameters


def assess(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    F: Tensor,
    inliers: Tensor,
    H: Tensor | None,
    threshold_px: float,
    seed: int = 0,
) -> Assessment:
    """Decide what an estimated epipolar geometry is evidence of.

    Args:
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        F: (3, 3) fundamental matrix of the estimated pose.
        inliers: (N,) bool, agreement with F.
        H: (3, 3) homography fitted robustly to the same matches, None when there was none.
        threshold_px: Largest distance of an inlier, pixels.
        seed: Of the measurement of chance agreement.
    """
    evidence = _chance_evidence(F, x1, x2, inliers, threshold_px, seed)
    n, k = len(x1), int(evidence["inliers"])
    if k < MIN_MATCHES or evidence["log10_false_alarms"] > MAX_LOG10_NFA:
        expected = n * evidence["chance_agreement"]
        reason = (
            f"{k:,} of {n:,} matches agree on one epipolar geometry; {expected:,.0f} would agree "
            "with any geometry by chance, and the best of many random ones does better than that."
        )
        return Assessment(Verdict.TOO_LITTLE, reason, evidence)
    chance = evidence["chance_agreement"]
    by_chance = min(1.0, (n - k) * chance / ((1 - chance) * k)) if chance < 1 else 1.0
    orientation = handedness(x1[inliers], x2[inliers], by_chance)
    evidence["orientation_kept"] = orientation.share_kept
    if orientation.inconsistent:
        return Assessment(Verdict.TOO_LITTLE, _orientation_reason(orientation), evidence)
    e_F = squared_sampson_distance(F, x1, x2)
    sigma = max(1.4826 * float(e_F[inliers].sqrt().median()), MIN_SIGMA_PX)
    evidence["sigma_px"] = sigma
    if H is None:
        return Assessment(Verdict.GENERAL, "No plane explains the matches.", evidence)
    return _compare(x1, x2, K1, K2, e_F, inliers, H, threshold_px, evidence)


def _orientation_reason(found: Handedness) -> str:
    count = found.kept + found.reversed
    measured = (
        f"{found.reversed:,} of {count:,} triangles between neighbouring inliers are reversed in "
        "image 2, which no camera motion does to a surface"
    )
    if found.mirrored:
        return f"{measured}: one of the photographs is mirrored."
    return f"{measured}: repeated or symmetric texture agrees on a wrong geometry."


def _chance_evidence(
    F: Tensor, x1: Tensor, x2: Tensor, inliers: Tensor, threshold_px: float, seed: int
) -> dict[str, float]:
    """How far the agreement of the matches with F is from chance."""
    n, k = len(x1), int(inliers.sum())
    generator = torch.Generator().manual_seed(seed)
    chance = chance_agreement(
        lambda a, b: squared_sampson_distance(F, a, b), x1, x2, threshold_px, generator
    )
    # A minimal sample of five matches gives up to ten essential matrices.
    nfa = log10_nfa(k, n, chance, sample=5, solutions=10)
    return {"matches": n, "inliers": k, "chance_agreement": chance, "log10_false_alarms": nfa}


def _compare(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    e_F: Tensor,
    inliers: Tensor,
    H: Tensor,
    threshold_px: float,
    evidence: dict[str, float],
) -> Assessment:
    """The explanation with the smallest GRIC: depth, plane or rotation."""
    sigma = evidence["sigma_px"]
    e_H = squared_homography_sampson_distance(H, x1, x2)
    # F can miss matches of the plane. They count too: without them, the criterion would compare the
    # models only where F fits.
    considered = inliers | (e_H < threshold_px**2)
    R0 = nearest_rotation(torch.linalg.solve(K2, H @ K1))
    R = fit_rotation(x1[considered], x2[considered], K1, K2, R0, scale_px=sigma)
    e_R = squared_homography_sampson_distance(K2 @ R @ torch.linalg.inv(K1), x1, x2)
    scores = {
        Verdict.GENERAL: gric(e_F[considered], sigma, 3, 5),
        Verdict.PLANAR: gric(e_H[considered], sigma, 2, 8),
        Verdict.PURE_ROTATION: gric(e_R[considered], sigma, 2, 3),
    }
    off_plane = float((e_H[inliers] > (3 * sigma) ** 2).double().mean())
    off_rotation = float((e_R[inliers] > (3 * sigma) ** 2).double().mean())
    motion_px = float((rotate_pixels(R, x1[inliers], K1, K2) - x2[inliers]).norm(dim=-1).median())
    evidence = evidence | {
        "gric_general": scores[Verdict.GENERAL],
        "gric_planar": scores[Verdict.PLANAR],
        "gric_rotation": scores[Verdict.PURE_ROTATION],
        "share_off_plane": off_plane,
        "share_off_rotation": off_rotation,
        "parallax_px": motion_px,
    }
    verdict = min(scores, key=scores.__getitem__)
    reason = {
        Verdict.GENERAL: f"{off_plane:.0%} of the inliers lie off the best plane, and "
        f"{off_rotation:.0%} do not move as under a pure rotation, by {motion_px:.1f} px in the "
        "median: a scene with depth, seen from two places.",
        Verdict.PLANAR: f"One plane explains {1 - off_plane:.0%} of the inliers as well as a scene "
        "with depth would, with fewer assumptions.",
        Verdict.PURE_ROTATION: f"A rotation alone explains {1 - off_rotation:.0%} of the inliers "
        f"(they move by {motion_px:.2f} px beyond it in the median): the camera did not move, so "
        "depth cannot be recovered.",
    }[verdict]
    return Assessment(verdict, reason, evidence, R if verdict is Verdict.PURE_ROTATION else None)


def nearest_rotation(A: Tensor) -> Tensor:
    """Find the rotation nearest to a multiple of a matrix, in the Frobenius norm.

    Args:
        A: (3, 3) of non-zero determinant.
    """
    U, _, Vt = torch.linalg.svd(A * torch.sign(torch.det(A)))
    signs = torch.ones(3, dtype=A.dtype, device=A.device)
    signs[2] = torch.det(U @ Vt)
    return U @ torch.diag(signs) @ Vt
