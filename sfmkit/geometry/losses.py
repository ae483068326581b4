"""Robust losses of squared residuals, and MAGSAC++'s marginal loss, which needs no noise level.

kornia 0.9.0 has none of these: its losses are means over images, without curvature or scale.
:mod:`.loss_kernels` has the formulas and their source.
"""

from __future__ import annotations

from torch import Tensor

from . import loss_kernels
from .checks import check_kind, check_values
from .loss_kernels import Loss, LossTerms

__all__ = ["Loss", "LossTerms", "loss_terms", "marginal_score", "marginal_weight"]


def loss_terms(loss: Loss, square: Tensor, scale: float) -> LossTerms:
    """Evaluate a loss at squared residuals of any shape.

    Args:
        scale: positive, in units of the residual: where ``huber`` becomes linear, where ``cauchy``
            levels off, or, for ``marginal``, the threshold beyond which a residual has no weight.
            ``squared`` ignores it.

    Raises:
        InputError: unknown loss, residuals that are not floats or not finite, or a scale outside
            1e-100 to 1e100, whose powers leave the range of floats.
    """
    check_kind(square=square)
    check_values(square=square)
    return loss_kernels.loss_terms(loss, square, scale)


def marginal_weight(square: Tensor, threshold: float) -> Tensor:
    """Return the weight of squared residuals in a least-squares fit.

    1 at zero, 0 from the threshold on.

    Raises:
        InputError: as for :func:`loss_terms`.
    """
    return loss_terms("marginal", square, threshold).slope


def marginal_score(square: Tensor, threshold: float) -> Tensor:
    """Return the score of squared residuals, one minus the marginal loss.

    1 at zero, 0 from the threshold on.

    Raises:
        InputError: as for :func:`loss_terms`.
    """
    check_kind(square=square)
    check_values(square=square)
    return loss_kernels.marginal_score(square, threshold)
