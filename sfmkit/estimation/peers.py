"""Robust estimation by other libraries, PoseLib and pycolmap (the ``peers`` extra), behind the same
calls. CPU only."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..geometry._checks import check_intrinsics, check_points
from ..geometry.essential import essential_from_pose
from ..geometry.fundamental import fundamental_from_essential, squared_sampson_distance
from ..geometry.homography import homography_sampson
from ..geometry.losses import marginal_score
from .result import RobustModel, supported

PEERS = ("poselib", "pycolmap")


def backend(name: str) -> Any:
    """The estimators of a peer, with the signatures of :mod:`sfmkit.estimation.opencv`; method is
    ``loransac`` only.

    Raises:
        InputError: no such peer, or it is not installed.
    """
    if name not in PEERS:
        raise InputError(
            f"there is no back end {name!r}; there are torch, opencv, {', '.join(PEERS)}"
        )
    module = _installed(name)
    fit = {"poselib": _poselib, "pycolmap": _pycolmap}[name]

    def estimate_essential(
        x1: Tensor,
        x2: Tensor,
        K1: Tensor,
        K2: Tensor,
        *,
        threshold_px: float = 1.0,
        method: str = "loransac",
        confidence: float = 0.9999,
        max_iterations: int = 10_000,
        seed: int = 0,
    ) -> RobustModel:
        """Essential matrix; see :func:`sfmkit.estimation.opencv.estimate_essential`."""
        check_intrinsics(x1, K1=K1, K2=K2)
        _check(name, x1, x2, method)
        found = fit(
            module, "essential", x1, x2, (K1, K2), threshold_px, confidence, max_iterations, seed
        )

        def square(E: Tensor) -> Tensor:
            return squared_sampson_distance(fundamental_from_essential(E, K1, K2), x1, x2)

        return supported(
            _result(found, square, x1, threshold_px), x1, x2, _LEAST["essential"], threshold_px
        )

    def estimate_fundamental(
        x1: Tensor,
        x2: Tensor,
        *,
        threshold_px: float = 1.0,
        method: str = "loransac",
        confidence: float = 0.9999,
        max_iterations: int = 10_000,
        seed: int = 0,
    ) -> RobustModel:
        """Fundamental matrix; see :func:`sfmkit.estimation.opencv.estimate_fundamental`."""
        _check(name, x1, x2, method)
        found = fit(
            module, "fundamental", x1, x2, None, threshold_px, confidence, max_iterations, seed
        )
        result = _result(found, lambda F: squared_sampson_distance(F, x1, x2), x1, threshold_px)
        return supported(result, x1, x2, _LEAST["fundamental"], threshold_px)

    def estimate_homography(
        x1: Tensor,
        x2: Tensor,
        *,
        threshold_px: float = 1.0,
        method: str = "loransac",
        confidence: float = 0.9999,
        max_iterations: int = 10_000,
        seed: int = 0,
    ) -> RobustModel:
        """Homography; see :func:`sfmkit.estimation.opencv.estimate_homography`."""
        _check(name, x1, x2, method)
        found = fit(
            module, "homography", x1, x2, None, threshold_px, confidence, max_iterations, seed
        )
        result = _result(found, lambda H: homography_sampson(H, x1, x2), x1, threshold_px)
        return supported(result, x1, x2, _LEAST["homography"], threshold_px)

    return SimpleNamespace(
        estimate_essential=estimate_essential,
        estimate_fundamental=estimate_fundamental,
        estimate_homography=estimate_homography,
    )


def _installed(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"{name} is not installed; it comes with the peers extra: pip install 'sfmkit[peers]'"
        ) from error


def _check(name: str, x1: Tensor, x2: Tensor, method: str) -> None:
    check_points(x1=x1, x2=x2)
    if method != "loransac":
        raise InputError(f"the {name} back end has no method {method!r}; it has loransac")


_LEAST = {"essential": 5, "fundamental": 8, "homography": 4}
Found = tuple[np.ndarray | None, int]


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
    """An ideal pinhole, as both libraries describe it: without skew."""
    if float(K[0, 1]) != 0:
        raise InputError("peers know no skew: K[0, 1] must be zero")
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
