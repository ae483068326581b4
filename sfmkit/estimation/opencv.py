"""Robust estimation by OpenCV: RANSAC and the USAC family. CPU only."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.coordinates import denormalize, normalize
from ..geometry.fundamental import fundamental_from_essential, squared_sampson_distance
from ..geometry.homography import squared_homography_sampson_distance
from ..geometry.loss_kernels import marginal_score
from .result import RobustModel, check_model, supported

METHODS = {
    "ransac": cv2.RANSAC,
    "lmeds": cv2.LMEDS,
    "usac_default": cv2.USAC_DEFAULT,
    "usac_fast": cv2.USAC_FAST,
    "usac_accurate": cv2.USAC_ACCURATE,
    "usac_magsac": cv2.USAC_MAGSAC,
}


def estimate(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor | None = None,
    K2: Tensor | None = None,
    *,
    model: str = "essential",
    threshold_px: float = 1.0,
    method: str | None = None,
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
) -> RobustModel:
    """Estimate E, F or H by ``cv2.findEssentialMat``, ``findFundamentalMat``, ``findHomography``.

    OpenCV assumes one camera for E; two different ones are both converted to a virtual camera with
    the mean focal length, so that the threshold stays in pixels.

    Args:
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3) intrinsics; for the essential matrix only.
        model: ``essential``, ``fundamental`` or ``homography``.
        method: a key of METHODS; None for ``usac_magsac``.
        seed: shuffles the matches; OpenCV starts its own generator anew on every call.

    Returns:
        RobustModel; without a model when there are fewer than 5 (E), 8 (F) or 4 (H) matches or
        OpenCV finds none.

    Raises:
        InputError: unknown model or method, shapes, dtypes, NaN.
    """
    check_model(model, x1, x2, K1, K2)
    flag = _flag(method or "usac_magsac")
    least, fit = _FITS[model]
    if len(x1) < least:
        return RobustModel.failed(len(x1), device=x1.device)
    models, squares = fit(x1, x2, K1, K2, flag, threshold_px, confidence, max_iterations, seed)
    best = _best([M.to(x1) for M in models], squares, x1, threshold_px)
    return supported(best, x1, x2, least, threshold_px)


Squares = Callable[[Tensor], Tensor]  # model -> (N,) squared Sampson distances, square pixels


def _essential(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    flag: int,
    threshold: float,
    confidence: float,
    most: int,
    seed: int,
) -> tuple[list[Tensor], Squares]:
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
        threshold=threshold,
        maxIters=most,
    )
    return found, lambda E: squared_sampson_distance(fundamental_from_essential(E, K1, K2), x1, x2)


def _fundamental(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor | None,
    K2: Tensor | None,
    flag: int,
    threshold: float,
    confidence: float,
    most: int,
    seed: int,
) -> tuple[list[Tensor], Squares]:
    (y1, T1), (y2, T2) = _centred(x1), _centred(x2)
    p1, p2 = _shuffled(y1, y2, seed)
    found = _solve(cv2.findFundamentalMat, p1, p2, flag, threshold, confidence, most)
    models = [T2.mT @ F.to(x1) @ T1 for F in found]
    return models, lambda F: squared_sampson_distance(F, x1, x2)


def _homography(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor | None,
    K2: Tensor | None,
    flag: int,
    threshold: float,
    confidence: float,
    most: int,
    seed: int,
) -> tuple[list[Tensor], Squares]:
    (y1, T1), (y2, T2) = _centred(x1), _centred(x2)
    p1, p2 = _shuffled(y1, y2, seed)
    found = _solve(
        cv2.findHomography, p1, p2, flag, threshold, maxIters=most, confidence=confidence
    )
    models = [torch.linalg.inv(T2) @ H.to(x1) @ T1 for H in found]
    return models, lambda H: squared_homography_sampson_distance(H, x1, x2)


# size of a minimal sample (8 for F, whose linear fit OpenCV uses), and the fit
_FITS: dict[str, tuple[int, Callable[..., tuple[list[Tensor], Squares]]]] = {
    "essential": (5, _essential),
    "fundamental": (8, _fundamental),
    "homography": (4, _homography),
}


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
