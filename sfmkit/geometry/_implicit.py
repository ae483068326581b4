"""Implicit derivatives of a minimum with respect to the data.

At the minimum, the gradient ``g(unknowns; data)`` is zero and stays zero when the data change, so
``d unknowns = -H^-1 dg`` with the exact Hessian H. The iterations that found the minimum are not
differentiated. Nothing is computed until a derivative is needed; it then takes one Hessian, one
linear solve, and one derivative of the gradient with respect to the data. Forward mode solves the
same system. Both modes consist of differentiable functions of the unknowns and the data, so second
derivatives are correct too.

Source: implicit function theorem; Krantz and Parks 2002; for bundle adjustment, Triggs et al. 2000,
section 10.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

import torch
from torch import Tensor

from .checks import _traced

Tensors = tuple[Tensor, ...]


class Objective(Protocol):
    """A minimisation problem over a manifold.

    A step is a tuple of tensors in the tangent space.
    """

    def zero(self, unknowns: Tensors) -> Tensors:
        """Return the zero step."""

    def move(self, unknowns: Tensors, step: Tensors) -> Tensors:
        """Return the unknowns after a step."""

    def cost(self, unknowns: Tensors, data: Tensors) -> Tensor:
        """Return the cost ``(*B,)``."""

    def solve(self, product: Callable[..., Tensors], g: Tensors) -> Tensors:
        """Return ``H^-1 g``, given the product of H with a step."""


def is_differentiated(data: Iterable[Tensor | None]) -> bool:
    """Return whether a derivative with respect to the data may be needed later."""
    if _traced():
        return True
    return torch.is_grad_enabled() and any(a is not None and a.requires_grad for a in data)


def attach_derivatives(objective: Objective, unknowns: Tensors, data: Tensors) -> Tensors:
    """Return the unknowns, differentiable with respect to the data."""
    return _Minimum.apply(objective, len(unknowns), *unknowns, *data)  # type: ignore[no-any-return]


def solve_dense(product: Callable[..., Tensors], g: Tensors) -> Tensors:
    """Return ``H^-1 g`` for one step tensor ``(*B, m)`` with a small m.

    If all residuals are beyond the threshold, no match has a weight and H is zero. The
    pseudo-inverse then gives a derivative of zero instead of an error.
    """
    (b,) = g
    (columns,) = torch.func.vmap(product)(unit_steps(b))
    H = columns.movedim(0, -1)
    return ((torch.linalg.pinv(H, rtol=1e-14) @ b[..., None])[..., 0],)


def unit_steps(like: Tensor) -> Tensor:
    """Return the unit steps ``(m, *B, m)`` along each of the m unknowns of ``(*B, m)``."""
    m = like.shape[-1]
    eye = torch.eye(m, dtype=like.dtype, device=like.device)
    return eye.reshape(m, *([1] * (like.ndim - 1)), m).expand(m, *like.shape)


def gradient(objective: Objective, unknowns: Tensors, data: Tensors, step: Tensors) -> Tensors:
    """Return the gradient of the cost with respect to a step from the unknowns."""

    def cost(step: Tensors) -> Tensor:
        return objective.cost(objective.move(unknowns, step), data).sum()

    return torch.func.grad(cost)(step)  # type: ignore[no-any-return]


def gradient_pullback(
    objective: Objective, unknowns: Tensors, data: Tensors
) -> Callable[[Tensors], tuple[Tensors, Tensors]]:
    """Return the map from a step s to ``H s`` and to the derivative of ``g . s``.

    H is the exact Hessian, and the derivative is that with respect to the data. The map can be
    vectorised over steps with ``torch.func.vmap``.
    """

    def slope(step: Tensors, data: Tensors) -> Tensors:
        return gradient(objective, unknowns, data, step)

    _, pullback = torch.func.vjp(slope, objective.zero(unknowns), data)  # type: ignore[misc]
    return pullback  # type: ignore[no-any-return]


class _Minimum(torch.autograd.Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(objective: Objective, n: int, *tensors: Tensor) -> Tensors:
        return tuple(a.clone() for a in tensors[:n])

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensors) -> None:
        ctx.objective, ctx.n, *tensors = inputs
        # The outputs are saved, not the inputs, so that a second derivative includes their
        # dependence on the data.
        ctx.save_for_backward(*output, *tensors[ctx.n :])
        ctx.save_for_forward(*output, *tensors[ctx.n :])

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:
        objective = ctx.objective
        unknowns, data = ctx.saved_tensors[: ctx.n], ctx.saved_tensors[ctx.n :]
        zero = objective.zero(unknowns)
        moved = torch.func.vjp(lambda *step: objective.move(unknowns, step), *zero)
        chart = moved[1]
        pullback = gradient_pullback(objective, unknowns, data)
        solved = objective.solve(lambda *step: pullback(step)[0], chart(grads))
        _, by_data = pullback(solved)
        return (None, None, *([None] * ctx.n), *(-a for a in by_data))

    @staticmethod
    def jvp(ctx: Any, _objective: None, _n: None, *tangents: Tensor) -> Tensors:
        objective = ctx.objective
        unknowns, data = ctx.saved_tensors[: ctx.n], ctx.saved_tensors[ctx.n :]
        zero = objective.zero(unknowns)
        pullback = gradient_pullback(objective, unknowns, data)
        # Transposed derivatives of linear maps need only reverse mode, at every level of nesting.
        _, by_data = torch.func.vjp(lambda *step: pullback(step)[1], *zero)  # type: ignore[misc]
        solved = objective.solve(lambda *step: pullback(step)[0], by_data(tangents[ctx.n :]))
        _, chart = torch.func.vjp(lambda *step: objective.move(unknowns, step), *zero)  # type: ignore[misc]
        _, push = torch.func.vjp(chart, tuple(torch.zeros_like(a) for a in unknowns))  # type: ignore[misc]
        return push(tuple(-a for a in solved))[0]
