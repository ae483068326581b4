"""Robust losses of squared residuals, including the marginal loss of MAGSAC++.

kornia 0.9.0 has no counterparts: its losses are means over images, without curvature or scale.
:mod:`.loss_kernels` contains the formulas and their source.
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
        loss: Name of the loss.
        square: Squared residuals.
        scale: Scale in units of the residual: the residual at which ``huber`` becomes linear and
            ``cauchy`` begins to level off, or the threshold beyond which a residual has no weight
            for ``marginal``. ``squared`` ignores it.

    Raises:
        InputError: The loss is unknown, the residuals are not floats or not finite, or the scale is
            outside 1e-100 to 1e100, so that its powers leave the range of floats.
    """
    check_kind(square=square)
    check_values(square=square)
    return loss_kernels.loss_terms(loss, square, scale)


def marginal_weight(square: Tensor, threshold: float) -> Tensor:
    """Return the weight of squared residuals in a least-squares fit.

    The weight is 1 at zero and 0 from the threshold on.

    Raises:
        InputError: As for :func:`loss_terms`.
    """
    return loss_terms("marginal", square, threshold).slope


def marginal_score(square: Tensor, threshold: float) -> Tensor:
    """Return the score of squared residuals, one minus the normalised marginal loss.

    The score is 1 at zero and 0 from the threshold on.

    Raises:
        InputError: As for :func:`loss_terms`.
    """
    check_kind(square=square)
    check_values(square=square)
    return loss_kernels.marginal_score(square, threshold)
