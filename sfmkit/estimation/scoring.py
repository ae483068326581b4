"""How well a match agrees with a model, when the noise level is not known: MAGSAC++'s marginal score.

A match's residual r is taken to be the length of a four-vector of Gaussian noise (two image points) of standard
deviation σ, cut off at ``k σ`` with k the 99 % quantile of the chi distribution with four degrees of freedom. σ is
not known: it is uniform up to ``σ_max = threshold / k``. Averaging over σ leaves, with ``u = r² / 2σ_max²``,

    weight(r) ∝ Γ(3/2, u) - Γ(3/2, k²/2)          (the weight of a match in a least-squares fit)
    loss(r)   ∝ ∫_0^r s weight(s) ds ∝ u Γ(3/2, u) + γ(5/2, u) - u Γ(3/2, k²/2)

both zero, or constant, beyond the threshold: no inlier/outlier decision is made inside it, and no noise level is set.

Source: Baráth, Noskova, Ivashechkin & Matas, "MAGSAC++, a fast, reliable and accurate robust estimator", CVPR 2020.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_K = 3.643721  # 99 % quantile of chi with 4 degrees of freedom: 99 % of the noise lies below K sigma
_U = _K**2 / 2
_HALF_SQRT_PI = math.sqrt(math.pi) / 2


def _upper_gamma(u: float) -> float:
    """Γ(3/2, u)."""
    return _HALF_SQRT_PI * math.erfc(math.sqrt(u)) + math.sqrt(u) * math.exp(-u)


_CUT = _upper_gamma(_U)
_MAX_LOSS = 1.5 * (_HALF_SQRT_PI - _CUT) - _U**1.5 * math.exp(-_U)


def marginal_weight(squared_residual: Tensor, threshold: float) -> Tensor:
    """Weight in [0, 1] of a match in a least-squares fit; 1 at residual 0, 0 from the threshold on.

    Args:
        squared_residual: any shape, not negative.
        threshold: in the residual's own units (pixels for pixels).
    """
    u = (squared_residual * (_U / threshold**2)).clamp(1e-30, _U)  # not 0: the root has no slope there
    root = u.sqrt()
    gamma = _HALF_SQRT_PI * torch.special.erfc(root) + root * torch.exp(-u)
    return (gamma - _CUT) / (_HALF_SQRT_PI - _CUT)


def marginal_score(squared_residual: Tensor, threshold: float) -> Tensor:
    """Score in [0, 1] of a match: 1 at residual 0, 0 from the threshold on. Arguments as for :func:`marginal_weight`."""
    u = (squared_residual * (_U / threshold**2)).clamp(1e-30, _U)  # not 0: the root has no slope there
    root = u.sqrt()
    e = root * torch.exp(-u)
    gamma = _HALF_SQRT_PI * torch.special.erfc(root) + e
    loss = u * (gamma - _CUT) + 1.5 * (_HALF_SQRT_PI - gamma) - u * e
    return 1 - loss / _MAX_LOSS
