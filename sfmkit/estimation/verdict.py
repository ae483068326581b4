"""What do the correspondences show: a general scene, a plane, a rotation without translation, or
too little to say?

The competing explanations are compared by Torr's geometric robust information criterion (GRIC): a
squared residual counts up to a limit, and a model pays for its dimension and its parameters, so
that the essential matrix, which fits anything that a homography fits, does not win by its freedom
alone. All residuals are first-order geometric (Sampson) distances in the joint image space of both
views, in pixels, so they can be compared with one another.

Whether there is anything to explain is decided first, a contrario (Moisan & Stival 2004): how many
models as good as this one would chance alone produce among this many matches?
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..geometry.coordinates import denormalize, normalize, to_homogeneous
from ..geometry.fundamental import signed_sampson_distance
from ..geometry.homography import squared_homography_sampson_distance
from ..types import Verdict

MIN_MATCHES = 8
MAX_LOG10_NFA = -6.0  # fewer than one model in a million by chance alone
MIN_SIGMA_PX = 0.1  # no detector localises better: keeps exact synthetic data from splitting hairs


@dataclass(frozen=True)
class Judgement:
    """A verdict, its reason in words, the numbers it rests on, and the rotation where that is all
    there is."""

    verdict: Verdict
    reason: str
    evidence: dict[str, float]
    rotation: Tensor | None = None


def fit_rotation(
    x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, R0: Tensor, scale_px: float
) -> Tensor:
    """(3, 3) rotation that turns the rays of x1 into those of x2, robustly, starting from R0.

    Iteratively reweighted Kabsch (Arun et al. 1987) with Cauchy weights at `scale_px`.
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
    """(N, 2) pixels in image 2 of image 1's rays turned by R: where points at infinity go."""
    y = to_homogeneous(normalize(x1, K1)) @ R.mT
    return denormalize(y[:, :2] / y[:, 2:], K2)


def gric(squared: Tensor, sigma: float, dimension: int, parameters: int) -> float:
    """Torr's criterion for N squared residuals (square pixels); smaller is better.

    Args:
        dimension: of the manifold in the 4-space of a correspondence: 3 for E and F, 2 for H and
            rotations.
        parameters: degrees of freedom of the model.

    Source: Torr, "An assessment of information criteria for motion model selection", CVPR 1997.
    """
    n, r = len(squared), 4
    rho = torch.clamp(squared / sigma**2, max=2.0 * (r - dimension)).sum()
    return float(rho) + math.log(r) * dimension * n + math.log(r * n) * parameters


def log10_nfa(inliers: int, matches: int, chance: float, sample: int, solutions: int) -> float:
    """log10 of the number of false alarms: models with this many inliers to be expected by chance
    alone.

    Args:
        chance: probability that a random match agrees with the model.
        sample, solutions: size of a minimal sample and the number of models it gives.
    """
    if inliers <= sample:
        return math.inf

    def log_choose(n: int, k: int) -> float:
        return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)

    return (
        math.log(solutions * (matches - sample))
        + log_choose(matches, inliers)
        + log_choose(inliers, sample)
        + (inliers - sample) * math.log(min(max(chance, 1e-12), 1.0))
    ) / math.log(10)


def chance_agreement(
    F: Tensor, x1: Tensor, x2: Tensor, threshold_px: float, seed: int = 0
) -> float:
    """Probability that a wrong match lies within `threshold_px` of F, measured on shuffled
    partners.

    Keypoints cluster, so this is larger than the share of the image that an epipolar band covers.
    """
    g = torch.Generator().manual_seed(seed)
    rounds = max(1, 20_000 // max(len(x1), 1))
    hits = 0
    for _ in range(rounds):
        order = torch.randperm(len(x1), generator=g).to(x1.device)
        hits += int((signed_sampson_distance(F, x1, x2[order]).abs() < threshold_px).sum())
    return (hits + 1) / (rounds * len(x1) + 1)


def judge(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    F: Tensor,
    inliers: Tensor,
    H: Tensor | None,
    threshold_px: float,
    seed: int = 0,
) -> Judgement:
    """Judge an estimated epipolar geometry.

    Args:
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        F: (3, 3) fundamental matrix of the estimated pose.
        inliers: (N,) bool, agreement with F.
        H: (3, 3) homography fitted robustly to the same matches, None when there was none.
        threshold_px: what made an inlier.
    """
    n, k = len(x1), int(inliers.sum())
    chance = chance_agreement(F, x1, x2, threshold_px, seed)
    nfa = log10_nfa(k, n, chance, sample=5, solutions=10)
    evidence = {"matches": n, "inliers": k, "chance_agreement": chance, "log10_false_alarms": nfa}
    if k < MIN_MATCHES or nfa > MAX_LOG10_NFA:
        reason = (
            f"{k:,} of {n:,} matches agree on one epipolar geometry; {n * chance:,.0f} would agree with any geometry by "
            "chance, and the best of many tries does better than that without meaning anything."
        )
        return Judgement(Verdict.TOO_LITTLE, reason, evidence)

    e_F = signed_sampson_distance(F, x1, x2) ** 2
    sigma = max(1.4826 * float(e_F[inliers].sqrt().median()), MIN_SIGMA_PX)
    evidence["sigma_px"] = sigma
    if H is None:
        return Judgement(Verdict.GENERAL, "No plane explains the matches.", evidence)

    e_H = squared_homography_sampson_distance(H, x1, x2)
    # Twice the inlier threshold: a plane's matches must not be dropped because F happens to miss
    # some of them.
    considered = inliers | (e_H < threshold_px**2)
    R0 = nearest_rotation(torch.linalg.solve(K2, H @ K1))
    R = fit_rotation(x1[considered], x2[considered], K1, K2, R0, scale_px=sigma)
    H_R = K2 @ R @ torch.linalg.inv(K1)
    e_R = squared_homography_sampson_distance(H_R, x1, x2)
    scores = {
        Verdict.GENERAL: gric(e_F[considered], sigma, 3, 5),
        Verdict.PLANAR: gric(e_H[considered], sigma, 2, 8),
        Verdict.PURE_ROTATION: gric(e_R[considered], sigma, 2, 3),
    }
    off_plane = float((e_H[inliers] > (3 * sigma) ** 2).double().mean())
    off_rotation = float((e_R[inliers] > (3 * sigma) ** 2).double().mean())
    motion_px = float((rotate_pixels(R, x1[inliers], K1, K2) - x2[inliers]).norm(dim=-1).median())
    evidence |= {
        "gric_general": scores[Verdict.GENERAL],
        "gric_planar": scores[Verdict.PLANAR],
        "gric_rotation": scores[Verdict.PURE_ROTATION],
        "share_off_plane": off_plane,
        "share_off_rotation": off_rotation,
        "parallax_px": motion_px,
    }
    verdict = min(scores, key=scores.__getitem__)
    reason = {
        Verdict.GENERAL: f"{off_plane:.0%} of the inliers lie off the best plane and {off_rotation:.0%} move otherwise than "
        f"under a pure rotation, by {motion_px:.1f} px in the median: a scene with depth, seen from two places.",
        Verdict.PLANAR: f"One plane explains {1 - off_plane:.0%} of the inliers as well as a scene with depth would, "
        "with fewer assumptions.",
        Verdict.PURE_ROTATION: f"A rotation alone explains {1 - off_rotation:.0%} of the inliers (they move by {motion_px:.2f} px "
        "beyond it in the median): the camera did not move, so depth cannot be recovered.",
    }[verdict]
    return Judgement(verdict, reason, evidence, R if verdict is Verdict.PURE_ROTATION else None)


def nearest_rotation(A: Tensor) -> Tensor:
    """The rotation nearest to a multiple of the (3, 3) matrix A of positive determinant, in the
    Frobenius norm."""
    A = A * torch.sign(torch.det(A))
    U, _, Vt = torch.linalg.svd(A)
    return (
        U
        @ torch.diag(
            torch.tensor([1.0, 1.0, float(torch.det(U @ Vt))], dtype=A.dtype, device=A.device)
        )
        @ Vt
    )
