"""Robust estimation by PoseLib and pycolmap (the ``peers`` extra) with the same interface.

CPU only.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.essential import essential_from_pose
from ..geometry.fundamental import fundamental_from_essential, squared_sampson_distance
from ..geometry.homography import squared_homography_sampson_distance
from ..geometry.loss_kernels import marginal_score
from .result import RobustModel, check_model, supported

PEERS = ("poselib", "pycolmap")


def estimate_poselib(
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
    """Estimate E, F or H by PoseLib's LO-RANSAC.

    Args:
        x1, x2: (N, 2) undistorted pixels.
        K1, K2: (3, 3) intrinsics without skew; for the essential matrix only.
        model: ``essential``, ``fundamental`` or ``homography``.
        method: ``loransac`` is the only one.

    Returns:
        RobustModel; without a model for fewer than 5 (E), 8 (F) or 4 (H) matches, or if the search
        finds none.

    Raises:
        InputError: PoseLib is not installed; unknown model or method, shapes, dtypes, NaN, skew.
    """
    settings = threshold_px, confidence, max_iterations, seed
    return _estimate("poselib", _poselib, x1, x2, K1, K2, model, method, settings)


def estimate_pycolmap(
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
    """Estimate E, F or H by COLMAP's LO-RANSAC; see :func:`estimate_poselib`."""
    settings = threshold_px, confidence, max_iterations, seed
    return _estimate("pycolmap", _pycolmap, x1, x2, K1, K2, model, method, settings)


Found = tuple[np.ndarray | None, int]  # the model, and the number of samples
Settings = tuple[float, float, int, int]  # threshold_px, confidence, max_iterations, seed


def _estimate(
    name: str,
    fit: Callable[..., Found],
    x1: Tensor,
    x2: Tensor,
    K1: Tensor | None,
    K2: Tensor | None,
    model: str,
    method: str | None,
    settings: Settings,
) -> RobustModel:
    module = _installed(name)
    check_model(model, x1, x2, K1, K2)
    if method not in (None, "loransac"):
        raise InputError(f"the {name} back end has no method {method!r}; it has loransac")
    cameras = None
    if model == "essential":
        assert K1 is not None
        assert K2 is not None
        cameras = K1, K2
    found = fit(module, model, x1, x2, cameras, *settings)

    def square(M: Tensor) -> Tensor:
        if model == "homography":
            return squared_homography_sampson_distance(M, x1, x2)
        F = M if cameras is None else fundamental_from_essential(M, *cameras)
        return squared_sampson_distance(F, x1, x2)

    result = _result(found, square, x1, settings[0])
    return supported(result, x1, x2, _LEAST[model], settings[0])


def _installed(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"{name} is not installed; it comes with the peers extra: pip install 'sfmkit[peers]'"
        ) from error


_LEAST = {"essential": 5, "fundamental": 8, "homography": 4}


def _poselib(
    poselib: Any,
    kind: str,
    x1: Tensor,
    x2: Tensor,
    cameras: tuple[Tensor, Tensor] | None,
    threshold: float,
    confidence: float,
    most: int,
    seed: int,
) -> Found:
    if len(x1) < _LEAST[kind]:
        return None, 0
    p1, p2 = _numpy(x1), _numpy(x2)
    ransac = {
        "success_prob": confidence,
        "max_iterations": most,
        "seed": seed,
        "min_iterations": min(1000, most),
    }
    ransac |= {"max_epipolar_error": threshold, "max_reproj_error": threshold}
    if cameras is None:
        M, info = getattr(poselib, f"estimate_{kind}")(p1, p2, ransac)
    else:
        pose, info = poselib.estimate_relative_pose(p1, p2, *(_camera(K) for K in cameras), ransac)
        M = _essential(pose.R, pose.t)
    found = bool(np.isfinite(M).all()) and info["num_inliers"] > 0
    return (M if found else None), int(info["iterations"])


def _camera(K: Tensor) -> dict[str, Any]:
    """Describe a pinhole camera for both libraries, which do not support skew."""
    if float(K[0, 1]) != 0:
        raise InputError("PoseLib and pycolmap do not support skew: K[0, 1] must be zero")
    fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    size = max(1, int(2 * cx) + 1), max(1, int(2 * cy) + 1)
    return {"model": "PINHOLE", "width": size[0], "height": size[1], "params": [fx, fy, cx, cy]}


def _pycolmap(
    pycolmap: Any,
    kind: str,
    x1: Tensor,
    x2: Tensor,
    cameras: tuple[Tensor, Tensor] | None,
    threshold: float,
    confidence: float,
    most: int,
    seed: int,
) -> Found:
    if len(x1) < _LEAST[kind]:
        return None, 0
    options = pycolmap.RANSACOptions(
        max_error=threshold,
        confidence=confidence,
        min_num_trials=min(1000, most),
        max_num_trials=most,
        random_seed=seed,
    )
    args = [_numpy(x1), _numpy(x2)] + [pycolmap.Camera(**_camera(K)) for K in cameras or ()]
    answer = getattr(pycolmap, f"estimate_{kind}_matrix")(*args, options)
    if answer is None:
        return None, 0
    return np.asarray(answer[{"essential": "E", "fundamental": "F", "homography": "H"}[kind]]), 0


def _essential(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    rotation, direction = (torch.from_numpy(np.array(a, dtype=np.float64)) for a in (R, t))
    return essential_from_pose(rotation, direction / direction.norm()).numpy()


def _numpy(x: Tensor) -> np.ndarray:
    return x.detach().double().cpu().numpy()


def _result(found: Found, squared_residual, x1: Tensor, threshold: float) -> RobustModel:
    M, iterations = found
    if M is None:
        return RobustModel.failed(len(x1), iterations, x1.device)
    model = torch.from_numpy(np.array(M, dtype=np.float64)).to(x1)
    square = squared_residual(model)
    return RobustModel(
        model, square < threshold**2, float(marginal_score(square, threshold).sum()), iterations
    )
