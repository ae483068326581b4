"""Learn a weight for each operator by gradient descent through the estimate of the pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.loss_kernels import Loss
from ..geometry.pose import rotation_error, translation_error
from ..geometry.refinement import refine_essential
from ..types import Correspondences


@dataclass(frozen=True, eq=False)
class PosedPair:
    """One image pair of the training set: its inliers and its true pose.

    Attributes:
        matches: correspondences without outliers (the loss is robust, but its minimum must be near
            the true pose).
        K1, K2: (3, 3) float64 intrinsics.
        R, t: (3, 3), (3,) float64 true pose, ``X2 = R X1 + t``.
    """

    matches: Correspondences
    K1: Tensor
    K2: Tensor
    R: Tensor
    t: Tensor


@dataclass(frozen=True, eq=False)
class PoseError:
    """Mean squared pose error over the pairs, square degrees, without and with weights.

    Attributes:
        equal: with equal weights.
        weighted: with the learned weights.
    """

    equal: float
    weighted: float


@dataclass(frozen=True, eq=False)
class OperatorWeights:
    """Learned weights, and whether they help on pairs that were not used to learn them.

    Attributes:
        operators: names.
        weights: (P,) float64, one per operator, with a geometric mean of 1: inverse variances up to
            a factor, if the operators differ only by the size of their errors.
        history: (steps + 1,) mean squared pose error over the pairs, square degrees, from equal
            weights to the end.
        training: the error on the pairs from which the weights were learned.
        held_out: the error of the cross-validation: each pair is measured with weights learned from
            the other folds. None for a single pair, which leaves nothing to learn from.
        improved: number of pairs on which the held-out weights reduce the error; 0 for a single
            pair.
        pairs: number of pairs.
    """

    operators: tuple[str, ...]
    weights: Tensor
    history: Tensor
    training: PoseError
    held_out: PoseError | None
    improved: int
    pairs: int

    @property
    def helps(self) -> bool:
        """Whether the weights reduce the held-out error, on average and on most pairs.

        The mean alone would follow the one pair with the largest error.
        """
        held_out = self.held_out
        if held_out is None:
            return False
        return held_out.weighted < held_out.equal and 2 * self.improved > self.pairs

    def of(self, matches: Correspondences) -> Tensor:
        """Return the weight of each match, (N,).

        :func:`refine_essential` and :func:`bundle_adjust` accept them.

        Raises:
            InputError: the operators of the matches are not those of the weights.
        """
        if matches.operators != self.operators:
            raise InputError(
                f"weights are for the operators {self.operators}, not {matches.operators}"
            )
        return match_weights(self.weights.log(), matches.operator_mask)


def match_weights(log_weights: Tensor, operator_mask: Tensor) -> Tensor:
    """Return the weight of each match: the geometric mean over the operators that found it.

    Args:
        log_weights: (P,) one per operator.
        operator_mask: (N,) int64, bit k set when operator k found the match.

    Returns:
        (N,) weights.
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
    folds: int | None = None,
) -> OperatorWeights:
    """Learn the operator weights that bring the refined poses closest to the truth.

    Each step refines the pose of every pair with the current weights, measures its squared angular
    error (rotation plus translation direction), and follows the derivative of that error with
    respect to the weights through the refinement, which is differentiated at its minimum (implicit
    function theorem). Adam on the logarithms of the weights.

    Weights that fit a few pairs can make others worse. The weights are therefore learned again
    without each fold of the pairs and judged on that fold: look at
    :attr:`OperatorWeights.held_out` and :attr:`OperatorWeights.helps` before using them.

    Args:
        pairs: with the same operators in the same order. Pairs of one scene share their errors:
            give them in sequence and choose the folds such that each scene falls into one fold.
        steps, learning_rate: of Adam; the rate is in units of log weight.
        loss, loss_scale: of the refinement, see :func:`sfmkit.geometry.losses.loss_terms`.
        folds: number of folds of consecutive pairs in the cross-validation; None leaves out one
            pair at a time. Time grows with it.

    Raises:
        InputError: no pairs, pairs with different operators, or folds outside 2 to the number of
            pairs.
    """
    if not pairs:
        raise InputError("learn_operator_weights needs at least one pair with a known pose")
    operators = pairs[0].matches.operators
    if any(p.matches.operators != operators for p in pairs):
        raise InputError("all pairs must have the same operators in the same order")
    if folds is not None and not 2 <= folds <= len(pairs):
        raise InputError(f"folds must be between 2 and the number of pairs, not {folds}")

    def learn(chosen: Sequence[PosedPair]) -> tuple[Tensor, Tensor]:
        return _learn(chosen, steps, learning_rate, loss, loss_scale)

    def errors(log_weights: Tensor, chosen: Sequence[PosedPair]) -> Tensor:
        return _squared_errors(log_weights, chosen, loss, loss_scale)

    log_weights, history = learn(pairs)
    equal = errors(torch.zeros_like(log_weights), pairs)
    training = PoseError(float(equal.mean()), float(history[-1]))
    held_out, improved = None, 0
    if len(pairs) > 1:
        weighted = torch.cat(
            [
                errors(learn([pairs[i] for i in rest])[0], [pairs[i] for i in fold])
                for fold, rest in _folds(len(pairs), folds or len(pairs))
            ]
        )
        held_out = PoseError(float(equal.mean()), float(weighted.mean()))
        improved = int((weighted < equal).sum())
    return OperatorWeights(
        operators, log_weights.exp(), history, training, held_out, improved, len(pairs)
    )


def _folds(n: int, folds: int) -> Iterator[tuple[list[int], list[int]]]:
    """Yield the consecutive members of each fold, and the other indices."""
    for k in range(folds):
        first, end = k * n // folds, (k + 1) * n // folds
        yield list(range(first, end)), [*range(first), *range(end, n)]


def _learn(
    pairs: Sequence[PosedPair], steps: int, learning_rate: float, loss: Loss, loss_scale: float
) -> tuple[Tensor, Tensor]:
    """Return the logarithms of the weights (P,) and the history (steps + 1,)."""
    log_weights = torch.zeros(
        len(pairs[0].matches.operators), dtype=torch.float64, requires_grad=True
    )
    optimiser = torch.optim.Adam([log_weights], lr=learning_rate)
    history = []
    for _ in range(steps):
        error = _squared_errors(log_weights, pairs, loss, loss_scale).mean()
        history.append(error.detach())
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
    learned = (log_weights - log_weights.mean()).detach()  # only ratios matter to the minimum
    history.append(_squared_errors(learned, pairs, loss, loss_scale).mean())
    return learned, torch.stack(history)


def _squared_errors(
    log_weights: Tensor, pairs: Sequence[PosedPair], loss: Loss, loss_scale: float
) -> Tensor:
    """Return the squared pose error of each pair, square degrees."""
    errors = []
    for p in pairs:
        weights = match_weights(log_weights, p.matches.operator_mask)
        m = p.matches
        R, t = refine_essential(
            p.R, p.t, m.x1, m.x2, p.K1, p.K2, weights, loss=loss, loss_scale=loss_scale
        ).pose
        errors.append(rotation_error(R, p.R) ** 2 + translation_error(t, p.t) ** 2)
    return torch.stack(errors)
