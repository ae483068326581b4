"""Robust estimation by OpenCV: RANSAC and the USAC family. CPU only."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry._checks import check_intrinsics, check_points
from ..geometry.coordinates import denormalize, normalize
from ..geometry.fundamental import fundamental_from_essential, sampson_distance
from ..geometry.homography import homography_sampson
from ..geometry.losses import marginal_score
from .result import RobustModel, supported

METHODS = {
    "ransac": cv2.RANSAC,
    "lmeds": cv2.LMEDS,
    "usac_default": cv2.USAC_DEFAULT,
    "usac_fast": cv2.USAC_FAST,
    "usac_accurate": cv2.USAC_ACCURATE,
    "usac_magsac": cv2.USAC_MAGSAC,
}


def estimate_essential(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    *,
    threshold_px: float = 1.0,
    method: str = "usac_magsac",
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
) -> RobustModel:
    """Essential matrix ``xn2^T E xn1 = 0`` by ``cv2.findEssentialMat``.

    OpenCV assumes one camera; two different ones are both turned into a virtual camera with the
    mean focal length, so that the threshold stays in pixels.

    Args:
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3).
        method: a key of METHODS.
        seed: OpenCV starts its own generator anew on every call; the seed shuffles the matches.

    Returns:
        RobustModel with E; without a model when there are fewer than 5 matches or OpenCV finds
        none.

    Raises:
        InputError: unknown method, shapes, dtypes, NaN.
    """
    check_points(x1=x1, x2=x2)
    check_intrinsics(x1, K1=K1, K2=K2)
    flag = _flag(method)
    if len(x1) < 5:
        return RobustModel.failed(len(x1), device=x1.device)
    if torch.equal(K1, K2):
        K = K1.clone()
        K[:2, 2] = 0  # OpenCV computes in float32: far from the origin its pixels are coarse
        p1, p2 = x1 - K1[:2, 2], x2 - K1[:2, 2]
    else:
        K = torch.diag(torch.ones(3, dtype=K1.dtype, device=K1.device))
        K[0, 0] = K[1, 1] = (K1[0, 0] + K1[1, 1] + K2[0, 0] + K2[1, 1]) / 4
        p1, p2 = denormalize(normalize(x1, K1), K), denormalize(normalize(x2, K2), K)
    found = _solve(
        cv2.findEssentialMat,
        *_shuffled(p1, p2, seed),
        K.cpu().numpy(),
        method=flag,
        prob=confidence,
        threshold=threshold_px,
        maxIters=max_iterations,
    )
    best = _best(
        [E.to(x1) for E in found],
        lambda E: sampson_distance(fundamental_from_essential(E, K1, K2), x1, x2) ** 2,
        x1,
        threshold_px,
    )
    return supported(best, x1, x2, 5, threshold_px)


def estimate_fundamental(
    x1: Tensor,
    x2: Tensor,
    *,
    threshold_px: float = 1.0,
    method: str = "usac_magsac",
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
) -> RobustModel:
    """Fundamental matrix ``x2^T F x1 = 0`` by ``cv2.findFundamentalMat``; arguments as for
    :func:`estimate_essential`.

    Without a model when there are fewer than 8 matches.
    """
    check_points(x1=x1, x2=x2)
    flag = _flag(method)
    if len(x1) < 8:
        return RobustModel.failed(len(x1), device=x1.device)
    (y1, T1), (y2, T2) = _centred(x1), _centred(x2)
    p1, p2 = _shuffled(y1, y2, seed)
    found = _solve(cv2.findFundamentalMat, p1, p2, flag, threshold_px, confidence, max_iterations)
    models = [T2.mT @ F.to(x1) @ T1 for F in found]
    best = _best(models, lambda F: sampson_distance(F, x1, x2) ** 2, x1, threshold_px)
    return supported(best, x1, x2, 8, threshold_px)


def estimate_homography(
    x1: Tensor,
    x2: Tensor,
    *,
    threshold_px: float = 1.0,
    method: str = "usac_magsac",
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
) -> RobustModel:
    """Homography ``x2 = H x1`` by ``cv2.findHomography``; arguments as for
    :func:`estimate_essential`.

    Without a model when there are fewer than 4 matches.
    """
    check_points(x1=x1, x2=x2)
    flag = _flag(method)
    if len(x1) < 4:
        return RobustModel.failed(len(x1), device=x1.device)
    (y1, T1), (y2, T2) = _centred(x1), _centred(x2)
    p1, p2 = _shuffled(y1, y2, seed)
    found = _solve(
        cv2.findHomography,
        p1,
        p2,
        flag,
        threshold_px,
        maxIters=max_iterations,
        confidence=confidence,
    )
    models = [torch.linalg.inv(T2) @ H.to(x1) @ T1 for H in found]
    best = _best(models, lambda H: homography_sampson(H, x1, x2), x1, threshold_px)
    return supported(best, x1, x2, 4, threshold_px)


def _flag(method: str) -> int:
    if method not in METHODS:
        raise InputError(
            f"the opencv back end has no method {method!r}; it has {', '.join(METHODS)}"
        )
    return METHODS[method]


def _shuffled(x1: Tensor, x2: Tensor, seed: int) -> tuple[np.ndarray, np.ndarray]:
    order = np.random.default_rng(seed).permutation(len(x1))
    return x1.detach().cpu().numpy()[order], x2.detach().cpu().numpy()[order]


def _centred(x: Tensor) -> tuple[Tensor, Tensor]:
    """The points about their mean, and the shift (3, 3): OpenCV computes in float32, coarse far
    from the origin."""
    T = torch.eye(3, dtype=x.dtype, device=x.device)
    T[:2, 2] = -x.detach().mean(0)
    return x + T[:2, 2], T


def _solve(function, *args, **kwargs) -> list[Tensor]:
    """Every solution: OpenCV returns none, one, or several 3 x 3 matrices stacked in rows."""
    try:
        M, _ = function(*args, **kwargs)
    except cv2.error:  # raised for some degenerate sets, such as one point repeated
        return []
    if M is None or M.size == 0 or not np.isfinite(M).all():
        return []
    return [torch.from_numpy(m.copy()) for m in M.reshape(-1, 3, 3) if np.any(m)]


def _best(models: list[Tensor], squared_residual, x1: Tensor, threshold_px: float) -> RobustModel:
    """The model of highest marginal score, with the inliers and the score as every back end counts
    them."""
    best = RobustModel.failed(len(x1), device=x1.device)
    for M in models:
        square = squared_residual(M)
        score = float(marginal_score(square, threshold_px).sum())
        if score > best.score:
            best = RobustModel(M, square < threshold_px**2, score, 0)
    return best
