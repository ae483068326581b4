"""Learning how far to trust each operator, by gradient descent through the estimate of the pose
itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.losses import Loss
from ..geometry.pose import rotation_error, translation_error
from ..geometry.refinement import refine_essential
from ..types import Correspondences


@dataclass(frozen=True, eq=False)
class PosedPair:
    """One pair of images to learn from: inlying matches and the true pose.

    Attributes:
        matches: correspondences without outliers (the loss is robust, but its minimum must be the
            right one).
        K1, K2: (3, 3) float64 intrinsics.
        R, t: (3, 3), (3,) float64 the true pose, ``X2 = R X1 + t``.
    """

    matches: Correspondences
    K1: Tensor
    K2: Tensor
    R: Tensor
    t: Tensor


@dataclass(frozen=True, eq=False)
class OperatorWeights:
    """What was learned.

    Attributes:
        operators: names.
        weights: (P,) float64, one per operator, with a geometric mean of 1: inverse variances up to
            a factor, if the operators differ only by the size of their errors.
        history: (steps + 1,) mean squared pose error over the pairs, square degrees, from equal
            weights to the end.
    """

    operators: tuple[str, ...]
    weights: Tensor
    history: Tensor

    def of(self, matches: Correspondences) -> Tensor:
        """(N,) the weight of each match, ready for :func:`refine_essential` and
        :func:`bundle_adjust`."""
        if matches.operators != self.operators:
            raise InputError(
                f"weights are for the operators {self.operators}, not {matches.operators}"
            )
        return match_weights(self.weights.log(), matches.operator_mask)


def match_weights(log_weights: Tensor, operator_mask: Tensor) -> Tensor:
    """(N,) weight of each match: the geometric mean over the operators that found it.

    Args:
        log_weights: (P,) one per operator.
        operator_mask: (N,) int64, bit k set when operator k found the match.
    """
    bits = torch.arange(len(log_weights), device=operator_mask.device)
    found = ((operator_mask[:, None] >> bits) & 1).to(log_weights.dtype)
    return torch.exp(found @ log_weights / found.sum(-1))


def learn_operator_weights(
    pairs: Sequence[PosedPair],
    *,
    steps: int = 60,
    learning_rate: float = 0.1,
    loss: Loss = "cauchy",
    loss_scale: float = 0.5,
) -> OperatorWeights:
    """The weight per operator under which the refined poses come closest to the truth.

    Each step refines the pose of every pair with the current weights, measures its squared angular
    error (rotation plus translation direction), and follows the derivative of that error by the
    weights through the refinement, which is differentiated at its minimum (implicit function
    theorem). Adam on the logarithms of the weights.

    A single pair has a single error to explain away: learn from several, and judge on others.

    Args:
        pairs: with the same operators in the same order.
        steps, learning_rate: of Adam; the rate is in units of log weight.
        loss, loss_scale: of the refinement, see :func:`sfmkit.geometry.losses.loss_terms`.

    Raises:
        InputError: without pairs, or when their operators differ.
    """
    if not pairs:
        raise InputError("learn_operator_weights needs at least one pair with a known pose")
    operators = pairs[0].matches.operators
    if any(p.matches.operators != operators for p in pairs):
        raise InputError("all pairs must have the same operators in the same order")
    log_weights = torch.zeros(len(operators), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([log_weights], lr=learning_rate)
    history = []
    for _ in range(steps):
        error = _mean_squared_error(log_weights, pairs, loss, loss_scale)
        history.append(error.detach())
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
    learned = (log_weights - log_weights.mean()).detach()  # only ratios matter to the minimum
    history.append(_mean_squared_error(learned, pairs, loss, loss_scale))
    return OperatorWeights(operators, learned.exp(), torch.stack(history))


def _mean_squared_error(
    log_weights: Tensor, pairs: Sequence[PosedPair], loss: Loss, loss_scale: float
) -> Tensor:
    errors = []
    for p in pairs:
        weights = match_weights(log_weights, p.matches.operator_mask)
        m = p.matches
        R, t = refine_essential(
            p.R, p.t, m.x1, m.x2, p.K1, p.K2, weights, loss=loss, loss_scale=loss_scale
        ).pose
        errors.append(rotation_error(R, p.R) ** 2 + translation_error(t, p.t) ** 2)
    return torch.stack(errors).mean()
