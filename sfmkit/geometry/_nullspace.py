"""Null vectors with finite derivatives of every order."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError


class _Detached(torch.autograd.Function):
    """A batched function that is not differentiated and that runs under torch.func.vmap.

    vmap passes whole batches, so the function may branch on values as eager code does.
    """

    @staticmethod
    def forward(
        function: Callable[..., tuple[Tensor, ...]], *tensors: Tensor
    ) -> tuple[Tensor, ...]:  # type: ignore[override]
        return function(*tensors)

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        ctx.mark_non_differentiable(*output)

    @staticmethod
    def backward(ctx, *grads):
        return (None,) * len(ctx.needs_input_grad)

    @staticmethod
    def jvp(ctx, *tangents):
        return None

    @staticmethod
    def vmap(info, in_dims, function, *tensors):
        batched = [
            (x.movedim(d, 0) if d is not None else x.expand(info.batch_size, *x.shape))
            for x, d in zip(tensors, in_dims[1:])
        ]
        out = _Detached.apply(function, *batched)
        return out, (0,) * len(out)


def detached(function: Callable[..., tuple[Tensor, ...]], *tensors: Tensor) -> tuple[Tensor, ...]:
    """Evaluate ``function(*tensors)`` as a constant.

    The function takes (*B, ...) tensors and returns a tuple of such tensors.
    """
    return _Detached.apply(function, *(x.detach() for x in tensors))


def eigh(M: Tensor) -> tuple[Tensor, Tensor]:
    """Return the eigenvalues and eigenvectors of symmetric (*B, n, n) matrices.

    Raises:
        DegenerateGeometryError: Entries are NaN or infinite, and LAPACK does not converge.
    """
    try:
        return torch.linalg.eigh(M)
    except torch.linalg.LinAlgError:
        raise DegenerateGeometryError(
            "the squares of these numbers or weights are outside the range of floats; scale them"
        ) from None


class _SmallestSingularVector(torch.autograd.Function):
    """The unit minimiser v of ``Σ w (A v)²``, differentiated by the implicit function theorem.

    With ``M = A^T W A`` and its smallest eigenvalue λ, ``dv = -(M - λ I)^+ dM v``. The backward
    pass consists of differentiable operations on A, w and v, so it can itself be differentiated.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(A: Tensor, w: Tensor) -> tuple[Tensor, Tensor]:  # type: ignore[override]
        values, vectors = eigh(A.mT @ (w[..., None] * A))
        v, rest = vectors[..., 0], vectors[..., 1:]
        gaps = values[..., 1:] - values[..., :1]
        floor = torch.finfo(A.dtype).eps * values[..., -1:]
        inverse = torch.where(gaps > floor, 1 / torch.where(gaps > floor, gaps, 1.0), 0.0)
        # The normal matrix has lost digits by squaring. One step with the residual of the rows
        # themselves restores them.
        normal = _apply(A.mT, w * _apply(A, v))
        v = v - _apply(rest, inverse * _apply(rest.mT, normal))
        gap = values[..., 1].clamp(min=0) / torch.where(values[..., -1] > 0, values[..., -1], 1.0)
        return v / v.norm(dim=-1, keepdim=True), gap

    @staticmethod
    def setup_context(ctx, inputs, output) -> None:
        A, w = inputs
        v, gap = output
        ctx.mark_non_differentiable(gap)
        ctx.save_for_backward(A, w, v, gap)
        ctx.save_for_forward(A, w, v, gap)

    @staticmethod
    def backward(ctx, grad_v: Tensor, _: Tensor):  # type: ignore[override]
        A, w, v, gap = ctx.saved_tensors
        u = _resolvent(A, w, v, gap, grad_v)
        Av, Au = _apply(A, v), _apply(A, u)
        grad_A = -(w * Av)[..., None] * u[..., None, :] - (w * Au)[..., None] * v[..., None, :]
        return grad_A, -Au * Av

    @staticmethod
    def jvp(ctx, dA: Tensor | None, dw: Tensor | None):  # type: ignore[override]
        A, w, v, gap = ctx.saved_tensors
        Av, change = _apply(A, v), torch.zeros_like(v)
        if dA is not None:
            change = change + _apply(dA.mT, w * Av) + _apply(A.mT, w * _apply(dA, v))
        if dw is not None:
            change = change + _apply(A.mT, dw * Av)
        return -_resolvent(A, w, v, gap, change), None


def _apply(A: Tensor, x: Tensor) -> Tensor:
    return (A @ x[..., None]).squeeze(-1)


def _resolvent(A: Tensor, w: Tensor, v: Tensor, gap: Tensor, g: Tensor) -> Tensor:
    """Compute ``(M - λ I)^+ g`` from the system bordered by v; zero where v is not unique."""
    n = A.shape[-1]
    M = A.mT @ (w[..., None] * A)
    scale = M.detach().diagonal(dim1=-2, dim2=-1).sum(-1)
    unique = (gap > torch.finfo(A.dtype).eps) & (scale > 0)
    M = M / torch.where(unique, scale, 1.0)[..., None, None]
    eye = torch.eye(n + 1, dtype=A.dtype, device=A.device)
    shifted = M - (v * _apply(M, v)).sum(-1)[..., None, None] * eye[:n, :n]
    right = torch.cat((v, torch.zeros_like(v[..., :1])), -1)[..., None]
    bordered = torch.cat((torch.cat((shifted, v[..., None, :]), -2), right), -1)
    bordered = torch.where(unique[..., None, None], bordered, eye)
    padded = torch.cat((g, torch.zeros_like(g[..., :1])), -1)[..., None]
    u, _ = torch.linalg.solve_ex(bordered, padded)
    u = u[..., :n, 0] / torch.where(unique, scale, 1.0)[..., None]
    return torch.where(unique[..., None], u, 0.0)


def smallest_singular_vector(A: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return the unit v that minimises ``Σ w (A v)²``, and a measure of its determinacy.

    v is computed from the n x n normal matrix, which avoids an SVD of all rows, and is then
    corrected with the residual ``A v``. The derivatives are implicit and correct to any order. They
    are finite wherever the smallest singular value is simple, even if it is zero, whereas the
    derivative of a full decomposition also divides by the differences of the other singular values.
    Where v is not unique, they are zero.

    Args:
        A: (*B, N, n) rows of the linear system.
        weights: (*B, N) or (N,) weights of the rows, not negative.

    Returns:
        v: (*B, n), of arbitrary sign.
        gap: (*B,) ratio of the second-smallest to the largest eigenvalue of the normal matrix, a
            constant; 0 where v is not unique.
    """
    w = torch.ones_like(A[..., 0]) if weights is None else weights.expand(A.shape[:-1])
    return _SmallestSingularVector.apply(A, w)
