"""Focal lengths from the fundamental matrix, in closed form.

With intrinsics `K1`, `K2` of which only the focal lengths are wrong, by the factors s1 and s2, the
essential matrix is ``E = D2 M D1``, where ``M = K2^T F K1`` and ``D = diag(s, s, 1)``. E has two
equal singular values, which is two equations:

- both focal lengths unknown: the equations determine them (Bougnoux);
- one unknown factor: an F from measurements does not satisfy both, and the factor is chosen that
  makes the two singular values as equal as possible. For ``E = D2 M D1``, their squares have the
  sum ``a = |E|^2`` and the product ``b = |cof E|^2``, both polynomials in ``w = s^2``; the ratio
  ``4 b / a^2`` is 1 for equal values, and its stationary points are the roots of a cubic (one
  factor shared by both cameras) or of a linear equation (one camera unknown).

The principal points must be right, and the images must not be taken in a configuration that leaves
the focal lengths undetermined: parallel optical axes, for a shared factor axes that meet at equal
distances from both cameras, for two factors axes that meet at all.
"""

from __future__ import annotations

import torch
from kornia.geometry.solvers import solve_cubic
from torch import Tensor

from . import kernels
from ._nullspace import detached, smallest_singular_vector
from .checks import check_matrices, check_nonzero

__all__ = ["one_focal", "shared_focal", "two_focals"]


def shared_focal(M: Tensor) -> tuple[Tensor, Tensor]:
    """Return the candidates for a focal factor that both cameras share, the best first.

    kornia 0.9.0 has no counterpart; its ``solve_cubic`` gives the roots. They are constants; two
    steps of Newton's method carry the derivatives.

    Args:
        M: (*B, 3, 3) ``K2^T F K1`` of any scale, with the principal points in K1 and K2.

    Returns:
        (s, valid). s (*B, 3), the factors of the focal lengths in K1 and K2; one where there is no
        candidate. valid (*B, 3) bool.

    Raises:
        DegenerateGeometryError: M is zero.
        InputError: The shape or dtype is wrong, or a value is not finite.

    Source: Mendonca and Cipolla, A simple technique for self-calibration, CVPR 1999 (the singular
    values); Hartley & Zisserman 19.4 (the equations of Kruppa).
    """
    (a2, a1, a0), (b2, b1, b0) = _invariants(M)
    cubic = torch.stack(
        (
            2 * a1 * b2 - a2 * b1,
            4 * a0 * b2 + a1 * b1 - 2 * a2 * b0,
            3 * a0 * b1,
            2 * a0 * b0,
        ),
        -1,
    )
    w, valid = detached(_positive_roots, cubic)
    c3, c2, c1, c0 = (c[..., None] for c in cubic.unbind(-1))
    for _ in range(2):
        slope = (3 * c3 * w + 2 * c2) * w + c1
        step = (((c3 * w + c2) * w + c1) * w + c0) / torch.where(slope != 0, slope, 1.0)
        w = torch.where(valid & (slope != 0), w - step, w)
    valid = valid & (w > 0)
    w = torch.where(valid, w, 1.0)
    a, b = (
        (p2[..., None] * w + p1[..., None]) * w + p0[..., None]
        for p2, p1, p0 in ((a2, a1, a0), (b2, b1, b0))
    )
    equality = torch.where(valid, w * w * b / a**2, -1.0).detach()
    order = equality.argsort(dim=-1, descending=True, stable=True)
    return w.sqrt().gather(-1, order).to(M.dtype), valid.gather(-1, order)


def one_focal(M: Tensor) -> tuple[Tensor, Tensor]:
    """Return the focal factor of camera 2 where camera 1 is known.

    kornia 0.9.0 has no counterpart.

    Args:
        M: (*B, 3, 3) ``K2^T F K1`` of any scale; its transpose where camera 2 is the known one.

    Returns:
        (s, valid): (*B,) and (*B,) bool; one where there is no positive solution.

    Raises:
        DegenerateGeometryError: M is zero.
        InputError: The shape or dtype is wrong, or a value is not finite.
    """
    dtype, M = M.dtype, _scaled(M)
    C = kernels.cofactors(M)
    (a1, a0), (b1, b0) = (_upper_and_last(A) for A in (M, C))
    s, valid = _root(b1 * a0, a1 * b1 - 2 * a0 * b0)
    return s.to(dtype), valid


def two_focals(M: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the focal factors of both cameras.

    kornia 0.9.0 has no counterpart.

    Args:
        M: (*B, 3, 3) ``K2^T F K1`` of any scale and of rank 2.

    Returns:
        (s1, s2, valid): (*B,) each; one, and not valid, where a factor is not real and positive.

    Raises:
        DegenerateGeometryError: M is zero.
        InputError: The shape or dtype is wrong, or a value is not finite.

    Source: Bougnoux, From projective to Euclidean space under any practical situation, a criticism
    of self-calibration, ICCV 1998.
    """
    dtype, M = M.dtype, _scaled(M)
    s1, valid1 = _bougnoux(M)
    s2, valid2 = _bougnoux(M.mT)
    valid = valid1 & valid2
    s1, s2 = (torch.where(valid, s, 1.0).to(dtype) for s in (s1, s2))
    return s1, s2, valid


def _bougnoux(M: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the factor of the camera to whose points M is applied."""
    e, _ = smallest_singular_vector(M.mT)
    x, y, _ = e.unbind(-1)
    row = y[..., None] * M[..., 0, :] - x[..., None] * M[..., 1, :]
    return _root(row[..., 2] * M[..., 2, 2], -(row[..., :2] * M[..., 2, :2]).sum(-1))


def _root(numerator: Tensor, denominator: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the square root of a quotient, and whether it is finite and positive."""
    w = numerator / torch.where(denominator != 0, denominator, 1.0)
    valid = (denominator != 0) & torch.isfinite(w) & (w > 0)
    return torch.where(valid, w, 1.0).sqrt(), valid


def _scaled(M: Tensor) -> Tensor:
    check_matrices(M=M)
    check_nonzero(M=M)
    return kernels.unit_norm(M.double())


def _upper_and_last(A: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the squared norms of the first two rows and of the last row."""
    square = A.square().sum(-1)
    return square[..., 0] + square[..., 1], square[..., 2]


def _invariants(M: Tensor) -> tuple[tuple[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]:
    """Compute the coefficients in w of ``|D M D|^2`` and ``|cof(D M D)|^2 / w^2``.

    The highest power comes first.
    """
    M = _scaled(M)
    C = kernels.cofactors(M)

    def parts(A: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        square = A * A
        edge = square[..., 2, :2].sum(-1) + square[..., :2, 2].sum(-1)
        return square[..., :2, :2].sum((-2, -1)), edge, square[..., 2, 2]

    b0, b1, b2 = parts(C)
    return parts(M), (b2, b1, b0)


def _positive_roots(cubic: Tensor) -> tuple[Tensor, Tensor]:
    """Return positive real roots (*B, 3) and a mask (*B, 3) of the slots in use."""
    roots = solve_cubic(cubic.reshape(-1, 4)).reshape(*cubic.shape[:-1], 3)
    valid = torch.isfinite(roots) & (roots > 0)
    return torch.where(valid, roots, 1.0), valid
