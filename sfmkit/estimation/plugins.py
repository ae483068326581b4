"""The extension point of robust estimators: contract, registry and the built-in back ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, Protocol, TypeVar

import torch
from torch import Tensor

from .._utils.registry import Registry, accepted
from . import opencv, peers, robust
from .result import RobustModel

F = TypeVar("F", bound=Callable)
_CONTRACT = frozenset(
    ("x1", "x2", "K1", "K2", "model", "method", "threshold_px", "confidence", "max_iterations")
    + ("seed", "ratio", "groups", "device")
)
Kind = Literal["essential", "fundamental", "homography"]


class Estimator(Protocol):
    """A robust estimator of the geometry of two views from matches of which many are wrong.

    A plug-in is a callable with the parameters of ``__call__`` below; it gets only those keywords
    that it takes. It may also take

    - ``model``: ``essential``, ``fundamental`` or ``homography``, what to estimate; an estimator
      without this parameter estimates essential matrices only;
    - ``method``: str or None, one of several methods, from ``EstimateOptions.method``;
    - ``device``: torch device on which to compute; the tensors are on the CPU, and the result
      must be;
    - options of its own, given in ``EstimateOptions.overrides``.

    The same input and seed must give the same output.
    """

    def __call__(
        self,
        x1: Tensor,
        x2: Tensor,
        K1: Tensor,
        K2: Tensor,
        *,
        threshold_px: float,
        confidence: float,
        max_iterations: int,
        seed: int,
        ratio: Tensor | None = None,
        groups: Tensor | None = None,
    ) -> RobustModel:
        """Estimate.

        Args:
            x1, x2: (N, 2) float64 undistorted pixels; N may be 0.
            K1, K2: (3, 3) float64 intrinsics.
            threshold_px: Sampson distance beyond which a match does not count, pixels.
            confidence: Probability with which no better model must have been missed.
            max_iterations: At most this many minimal samples.
            seed: Of the random numbers.
            ratio: (N,) ratios of the best to the second-best descriptor distance, smaller for a
                more distinctive match, NaN where unknown.
            groups: (N,) int64, the operator that found each match.

        Returns:
            The model, (3, 3): E in normalised coordinates (``xn2^T E xn1 = 0``), F or H in pixels;
            and which matches agree with it. :meth:`RobustModel.failed` where none was found.
        """


ESTIMATOR_PLUGINS: Registry[Callable[..., RobustModel]] = Registry("estimator", "sfmkit.estimators")
ESTIMATOR_PLUGINS.register("torch", robust.estimate)
ESTIMATOR_PLUGINS.register("opencv", opencv.estimate)
ESTIMATOR_PLUGINS.register("poselib", peers.estimate_poselib)
ESTIMATOR_PLUGINS.register("pycolmap", peers.estimate_pycolmap)


def register_estimator(name: str, estimator: F) -> F:
    """Register a robust estimator under a name, for this process.

    Args:
        name: What the estimator is called in ``EstimateOptions.backend``, ``--backend``, reports.
        estimator: A callable that obeys the contract of :class:`Estimator`.

    Returns:
        `estimator`.

    Raises:
        InputError: `estimator` is not callable, or the name is malformed or taken.
    """
    ESTIMATOR_PLUGINS.register(name, estimator)
    return estimator


def check_estimator(
    name: str,
    *,
    model: Kind = "essential",
    method: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> None:
    """Check that an estimator exists and takes these settings.

    Args:
        name: Name or import path of the estimator.
        model: The model to estimate.
        method: A method of the estimator, None for its best.
        overrides: The estimator's own options.

    Raises:
        InputError: The estimator is unknown, does not estimate this model, has no methods, or has
            no such option.
    """
    settings = {"model": model, "method": method, **(overrides or {})}
    taken = accepted(ESTIMATOR_PLUGINS[name], settings, rest=True)
    if "model" not in taken and model != "essential":
        raise ESTIMATOR_PLUGINS.error(
            f"estimator '{name}' has no parameter 'model': it estimates essential matrices only"
        )
    if "method" not in taken and method is not None:
        raise ESTIMATOR_PLUGINS.error(f"estimator '{name}' has no methods to choose from")
    for option in overrides or {}:
        if option in _CONTRACT:
            raise ESTIMATOR_PLUGINS.error(
                f"'{option}' is a parameter of every estimator; it cannot be among the overrides"
            )
        if option not in taken:
            raise ESTIMATOR_PLUGINS.error(f"estimator '{name}' has no option '{option}'")


def run_estimator(
    name: str,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    *,
    model: Kind = "essential",
    method: str | None = None,
    threshold_px: float = 1.0,
    confidence: float = 0.9999,
    max_iterations: int = 10_000,
    seed: int = 0,
    ratio: Tensor | None = None,
    groups: Tensor | None = None,
    device: Any = None,
    overrides: Mapping[str, Any] | None = None,
) -> RobustModel:
    """Run an estimator and check that its result fulfils the contract.

    Args:
        name: Name or import path of the estimator.
        overrides: The estimator's own options. The other arguments are those of
            :class:`Estimator`.

    Raises:
        InputError: The estimator is unknown or does not take these settings (see
            :func:`check_estimator`), it failed, or its result is invalid.
    """
    check_estimator(name, model=model, method=method, overrides=overrides)
    keywords = {
        "model": model,
        "method": method,
        "threshold_px": threshold_px,
        "confidence": confidence,
        "max_iterations": max_iterations,
        "seed": seed,
        "ratio": ratio,
        "groups": groups,
        "device": device,
    }
    taken = accepted(ESTIMATOR_PLUGINS[name], keywords, rest=True) | dict(overrides or {})
    found = ESTIMATOR_PLUGINS.call(name, x1, x2, K1, K2, **taken)
    reason = _fault(found, len(x1))
    if reason:
        raise ESTIMATOR_PLUGINS.reject(name, found, reason)
    return found


def _fault(found: Any, n: int) -> str:
    """What is wrong with the result of an estimator; empty where nothing is."""
    if not isinstance(found, RobustModel):
        return "it must be a RobustModel"
    inliers, model = found.inliers, found.model
    if not isinstance(inliers, Tensor) or inliers.shape != (n,) or inliers.dtype != torch.bool:
        return f"inliers must be a bool tensor of shape ({n},)"
    if model is None:
        return ""
    if not isinstance(model, Tensor) or model.shape != (3, 3) or model.dtype != torch.float64:
        return "model must be a float64 tensor of shape (3, 3), or None"
    if not bool(torch.isfinite(model).all()):
        return "model holds NaN or infinite values"
    return ""
