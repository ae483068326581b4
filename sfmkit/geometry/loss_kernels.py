"""Robust losses of squared residuals, including the marginal loss of MAGSAC++.

The functions run in the inner loops of the refinements and check only types and scales; a NaN
residual gives a NaN value. The public functions in :mod:`.losses` reject NaN.

The marginal loss needs no noise level. The residual r of a match is modelled as the length of a
four-vector of Gaussian noise (two image points) with the standard deviation σ, cut off at ``k σ``,
where k is the 99 % quantile of the chi distribution with four degrees of freedom. σ is unknown and
modelled as uniform up to ``σ_max = threshold / k``. The average over σ is, with
``u = r² / 2σ_max²``,

    weight(r) ∝ Γ(3/2, u) - Γ(3/2, k²/2)          (the weight of a match in a least-squares fit)
    loss(r)   ∝ ∫_0^r s weight(s) ds ∝ u Γ(3/2, u) + γ(5/2, u) - u Γ(3/2, k²/2)

Beyond the threshold, the weight is zero and the loss constant. Within the threshold, no match is
classified as an inlier or outlier.

Source: Baráth, Noskova, Ivashechkin & Matas, "MAGSAC++, a fast, reliable and accurate robust
estimator", CVPR 2020.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from ..errors import InputError
from .checks import check_kind, check_scale

Loss = Literal["squared", "huber", "cauchy", "marginal"]

_K = 3.643721  # 99 % quantile of chi with 4 degrees of freedom
_U = _K**2 / 2
_GAMMA = math.sqrt(math.pi) / 2  # Γ(3/2)
_CUT = _GAMMA * math.erfc(math.sqrt(_U)) + math.sqrt(_U) * math.exp(-_U)  # Γ(3/2, k²/2)
_MAX_LOSS = 1.5 * (_GAMMA - _CUT) - _U**1.5 * math.exp(-_U)


class LossTerms(NamedTuple):
    """A loss and its first two derivatives with respect to the squared residual.

    The slope is 1 at zero.
    """

    value: Tensor
    slope: Tensor
    curvature: Tensor


def loss_terms(loss: Loss, square: Tensor, scale: float) -> LossTerms:
    """Evaluate a loss at squared residuals of any shape.

    Args:
        loss: Name of the loss.
        square: Squared residuals.
        scale: Scale in units of the residual: the residual at which ``huber`` becomes linear and
            ``cauchy`` begins to level off, or the threshold beyond which a residual has no weight
            for ``marginal``. ``squared`` ignores it.

    Raises:
        InputError: The loss is unknown, the residuals are not floats, or the scale is outside
            1e-100 to 1e100, so that its powers leave the range of floats.
    """
    check_kind(square=square)
    if loss != "squared":
        check_scale(scale=scale)
    if loss == "squared":
        return LossTerms(square, torch.ones_like(square), torch.zeros_like(square))
    k2 = _squared(scale, square.dtype)
    if loss == "huber":
        root = square.clamp(min=k2).sqrt()
        outside = square > k2
        value = torch.where(outside, 2 * scale * root - k2, square)
        return LossTerms(value, scale / root, torch.where(outside, -scale / (2 * root**3), 0.0))
    if loss == "cauchy":
        slope = 1 / (1 + square / k2)
        return LossTerms(k2 * torch.log1p(square / k2), slope, -slope * slope / k2)
    if loss == "marginal":
        u, lower, e = _incomplete_gamma(square * (_U / k2))
        value = (k2 / _U) * _marginal_loss(u, lower, e) / (_GAMMA - _CUT)
        slope = (1 - lower / (_GAMMA - _CUT)).clamp(min=0)
        return LossTerms(value, slope, torch.where(u < _U, -e * (_U / k2) / (_GAMMA - _CUT), 0.0))
    raise InputError(f"loss must be 'squared', 'huber', 'cauchy' or 'marginal', not {loss!r}")


def marginal_weight(square: Tensor, threshold: float) -> Tensor:
    """Return the weight of squared residuals in a least-squares fit.

    The weight is 1 at zero and 0 from the threshold on.
    """
    return loss_terms("marginal", square, threshold).slope


def marginal_score(square: Tensor, threshold: float) -> Tensor:
    """Return the score of squared residuals, one minus the normalised marginal loss.

    The score is 1 at zero and 0 from the threshold on.

    Raises:
        InputError: The residuals are not floats, or the threshold is outside 1e-100 to 1e100.
    """
    check_kind(square=square)
    check_scale(threshold=threshold)
    return (
        1
        - _marginal_loss(*_incomplete_gamma(square * (_U / _squared(threshold, square.dtype))))
        / _MAX_LOSS
    )


def _squared(scale: float, dtype: torch.dtype) -> float:
    limits = torch.finfo(dtype)
    if not limits.tiny <= scale**2 <= limits.max / _U:
        raise InputError(f"the square of {scale} is outside the range of {dtype}")
    return scale**2


def _incomplete_gamma(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return u cut off at k²/2, the lower incomplete gamma γ(3/2, u), and ``sqrt(u) exp(-u)``."""
    u = u.clamp(1e-30, _U)  # not 0, where the derivative of the root is infinite
    small = u < 1e-3  # where the difference below loses digits by cancellation
    v = torch.where(small, u, 0.0)
    series = v**1.5 * (2 / 3 - v * (2 / 5 - v * (1 / 7 - v / 27)))
    w = torch.where(small, 1.0, u)
    root = w.sqrt()
    e = torch.exp(-w)
    lower = torch.where(small, series, _GAMMA * torch.special.erf(root) - root * e)
    return u, lower, u.sqrt() * torch.exp(-u)


def _marginal_loss(u: Tensor, lower: Tensor, e: Tensor) -> Tensor:
    return u * (_GAMMA - _CUT - lower) + 1.5 * lower - u * e
