"""The Levenberg-Marquardt algorithm for a batch of problems, each with its own damping.

Source: Madsen, Nielsen and Tingleff, Methods for non-linear least squares problems, 2004.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from .checks import _traced

S = TypeVar("S", bound=tuple[Any, ...])

_NEAR = 1e-2  # share of the cost; a step that gains less is near the minimum
_ROUNDING = 1e-12  # share of the cost; an upper bound of its rounding error


class Trial(NamedTuple, Generic[S]):
    """A proposed step: the resulting state, its cost ``(*B,)``, and the predicted gain."""

    state: S
    cost: Tensor
    gain: Tensor


@dataclass(frozen=True)
class Schedule:
    """Stopping rule and damping.

    Attributes:
        max_iterations: Maximum number of linearisations.
        tolerance: Fraction of the cost; a step with a smaller predicted gain is the last one.
        floor: The same in units of the cost, for exact data, whose cost is only rounding error.
        damping: Initial damping.
        factor: Factor by which the damping decreases after a good step and increases after a bad
            step.
        polish: Number of undamped steps after convergence. The cost determines the minimum only to
            the square root of the rounding error, but derivatives require it to full precision.
    """

    max_iterations: int
    tolerance: float
    floor: float
    damping: float
    factor: float = 10.0
    polish: int = 0


class Minimised(NamedTuple, Generic[S]):
    """The result: history is ``(*B, iterations + 1)``, the other tensors ``(*B,)``."""

    state: S
    history: Tensor
    iterations: Tensor
    converged: Tensor


def levenberg_marquardt(
    state: S,
    cost: Tensor,
    propose: Callable[[S, Tensor, Tensor], Trial[S]],
    schedule: Schedule,
    converged: Tensor | None = None,
) -> Minimised[S]:
    """Minimise from `state` with cost ``(*B,)``.

    Args:
        state: A named tuple of tensors with leading dimensions B, or of such tuples.
        propose: Function that maps the state, the damping ``(*B,)`` and a mask ``(*B,)`` of the
            items near their minimum to a step.
        converged: ``(*B,)`` mask of the items that stay unchanged.
    """
    # Inside a transform, values cannot be read to decide when to stop: all iterations are run.
    watched = not _traced()
    damping = torch.full_like(cost, schedule.damping)
    iterations = torch.zeros_like(cost, dtype=torch.int64)
    if converged is None:
        converged = torch.zeros_like(cost, dtype=torch.bool)
    near = torch.zeros_like(converged)
    history = [cost]
    for _ in range(schedule.max_iterations):
        trial = propose(state, damping, near)
        iterations = iterations + (~converged).long()
        better = (trial.cost <= cost) & ~converged
        arrived = trial.gain.abs() <= schedule.tolerance * cost + schedule.floor
        state = _select(better, trial.state, state)
        cost = torch.where(better, trial.cost, cost)
        damping = torch.where(better, damping / schedule.factor, damping * schedule.factor)
        near = better & (trial.gain < _NEAR * cost)
        converged = converged | arrived
        history.append(cost)
        if watched and bool(converged.all()):
            break
    for _ in range(schedule.polish):
        trial = propose(state, torch.zeros_like(cost), converged)
        as_good = trial.cost <= cost * (1 + _ROUNDING) + schedule.floor
        state = _select(converged & as_good, trial.state, state)
    return Minimised(state, torch.stack(history, -1), iterations, converged)


def _select(condition: Tensor, a: Any, b: Any) -> Any:
    """Return a where the condition ``(*B,)`` holds and b elsewhere, for nested tuples."""
    if isinstance(a, Tensor):
        missing = a.ndim - condition.ndim
        return torch.where(condition.reshape(condition.shape + (1,) * missing), a, b)
    parts = [_select(condition, i, j) for i, j in zip(a, b)]
    return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
