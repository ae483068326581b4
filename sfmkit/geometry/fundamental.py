"""The fundamental matrix, ``x2^T F x1 = 0`` in pixels: estimation, epipolar lines and distances."""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import InputError
from ._checks import check_determined, check_intrinsics, check_matrices, check_points
from ._nullspace import detached, null_space, smallest_singular_vector
from ._roots import nodes, real_roots
from .coordinates import _hartley, inverse_intrinsics, to_homogeneous
from .lie import hat


def fundamental_8point(x1: Tensor, x2: Tensor, weights: Tensor | None = None) -> Tensor:
    """F from 8 or more matches: the normalised eight-point algorithm, linear least squares and then
    rank 2.

    Args:
        x1, x2: (*B, N, 2) pixels, N >= 8.
        weights: (*B, N) or (N,) of the squared algebraic residuals.

    Returns:
        (*B, 3, 3) of unit Frobenius norm and rank 2; the sign is arbitrary. Float32 is computed in
        float64.

    Raises:
        DegenerateGeometryError: fewer than 8 matches, or matches that leave F open: of one plane,
            collinear, repeated (in a batch: when all its members are so; where only some are, their
            F is finite but means nothing).
        InputError: shapes, dtypes, devices, NaN.

    Source: Hartley & Zisserman 11.2, algorithm 11.1. kornia's ``find_fundamental`` differentiates
    through an SVD, which is NaN where singular values meet; here the null vectors are
    differentiated implicitly.
    """
    check_points(8, weights, x1=x1, x2=x2)
    dtype = x1.dtype
    x1, x2 = x1.double(), x2.double()
    weights = None if weights is None else weights.double()
    n1, T1 = _hartley(x1, weights)
    n2, T2 = _hartley(x2, weights)
    f, gap = smallest_singular_vector(epipolar_rows(n1, n2), weights)
    check_determined(
        gap, dtype, "F", "they may lie on one plane, on one line, or repeat one another"
    )
    F = T2.mT @ rank2(f.unflatten(-1, (3, 3))) @ T1
    return unit_norm(F).to(dtype)


def fundamental_7point(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """All real fundamental matrices of seven matches; differentiated implicitly.

    Args:
        x1, x2: (*B, 7, 2) pixels.

    Returns:
        F: (*B, 3, 3, 3), one to three solutions of unit Frobenius norm and rank 2, arbitrary sign;
            zero where there is none.
        valid: (*B, 3) bool, the solutions first.

    Raises:
        InputError: not exactly 7 matches; shapes, dtypes, devices, NaN.

    Source: Hartley & Zisserman 11.1.2; the cubic is evaluated on the circle and its roots bracketed
    there (``_roots``).
    """
    check_points(7, x1=x1, x2=x2)
    if x1.shape[-2] != 7:
        raise InputError(f"the seven-point algorithm needs exactly 7 matches, not {x1.shape[-2]}")
    dtype = x1.dtype
    (n1, T1), (n2, T2) = _hartley(x1.double()), _hartley(x2.double())
    F, valid = detached(_all_solutions, n1, n2)
    rows = epipolar_rows(n1, n2)[..., None, :, :]
    for _ in range(2):  # the first step polishes, the second carries the derivatives
        F = F.detach()
        F = F - _seven_point_step(F, rows, valid)
    F = T2.mT[..., None, :, :] @ F @ T1[..., None, :, :]
    size = F.flatten(-2).norm(dim=-1)[..., None, None]
    return torch.where(valid[..., None, None], F / torch.where(size > 0, size, 1.0), 0.0).to(
        dtype
    ), valid


def seven_point(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """All real solutions of B samples, without derivatives.

    Args:
        x1, x2: (B, 7, 2) Hartley-normalised.

    Returns:
        F: (M, 3, 3) of unit norm. owner: (M,) int64, ascending: the sample that a solution is of.
    """
    N = null_space(epipolar_rows(x1, x2)).mT.unflatten(-1, (3, 3))
    N = unit_norm(N)
    A, B = N[:, 0], N[:, 1]
    angles = torch.tensor(nodes(3), dtype=x1.dtype, device=x1.device)[:, None, None]
    values = torch.linalg.det(A[:, None] * angles.cos() + B[:, None] * angles.sin())
    owner, angle = real_roots(values, cells=96)
    F = A[owner] * angle.cos()[:, None, None] + B[owner] * angle.sin()[:, None, None]
    return unit_norm(F), owner


def _all_solutions(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """(*B, 3, 3, 3) solutions and which of the three slots hold one."""
    batch = x1.shape[:-2]
    x1, x2 = x1.reshape(-1, 7, 2), x2.reshape(-1, 7, 2)
    F, owner = seven_point(x1, x2)
    good = F.isfinite().all(-1).all(-1)
    return slots(F[good], owner[good], len(x1), 3, batch)


def slots(
    M: Tensor, owner: Tensor, samples: int, most: int, batch: tuple[int, ...]
) -> tuple[Tensor, Tensor]:
    """Solutions (M, 3, 3) by sample as (*B, most, 3, 3), zeros where there is none, and which slots
    hold one."""
    count = torch.bincount(owner, minlength=samples)
    slot = torch.arange(len(owner), device=M.device) - (count.cumsum(0) - count)[owner]
    out = M.new_zeros(samples, most, 3, 3)
    out[owner[slot < most], slot[slot < most]] = M[slot < most]
    valid = torch.arange(most, device=M.device) < count[:, None]
    return out.reshape(*batch, most, 3, 3), valid.reshape(*batch, most)


def _seven_point_step(F: Tensor, rows: Tensor, valid: Tensor) -> Tensor:
    """The change of the constant F that Newton's method makes for: seven matches, a zero
    determinant, a fixed norm."""
    f = F.flatten(-2)[..., None]
    minors = cofactors(F)
    J = torch.cat(
        (rows.detach().expand(*F.shape[:-2], 7, 9), minors.flatten(-2)[..., None, :], f.mT), -2
    )
    determinant = (F[..., 0, :] * minors[..., 0, :]).sum(-1)[..., None, None]
    value = torch.cat((rows @ f, determinant, torch.zeros_like(determinant)), -2)
    J = torch.where(valid[..., None, None], J, torch.eye(9, dtype=F.dtype, device=F.device))
    return torch.linalg.solve_ex(J, value)[0].unflatten(-2, (3, 3)).squeeze(-1)


def cofactors(A: Tensor) -> Tensor:
    """(*B, 3, 3) matrix of cofactors: the cross products of the rows."""
    a, b, c = A.unbind(-2)
    return torch.stack([torch.linalg.cross(p, q, dim=-1) for p, q in ((b, c), (c, a), (a, b))], -2)


def epipolar_rows(x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N, 9) with ``rows @ F.flatten() = x2^T F x1``."""
    u, v = x2[..., :1], x2[..., 1:]
    h1 = to_homogeneous(x1)
    return torch.cat((u * h1, v * h1, h1), -1)


def rank2(F: Tensor) -> Tensor:
    """The nearest singular matrix in the Frobenius norm, ``F - (F v) v^T`` with v the weakest right
    singular vector.

    The same as zeroing the smallest singular value, with a finite derivative when it is zero
    already.
    """
    v, _ = smallest_singular_vector(F)
    return F - (F @ v[..., None]) * v[..., None, :]


def unit_norm(F: Tensor) -> Tensor:
    """The (*B, 3, 3) matrices divided by their Frobenius norms."""
    return F / F.flatten(-2).norm(dim=-1)[..., None, None]


def fundamental_from_essential(E: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """``F = K2^-T E K1^-1``, (*B, 3, 3), not rescaled. Source: Hartley & Zisserman, eq. 9.12."""
    check_matrices(E=E)
    check_intrinsics(E, K1=K1, K2=K2)
    return inverse_intrinsics(K2).mT @ E @ inverse_intrinsics(K1)


def fundamental_from_pose(R: Tensor, t: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """``F = K2^-T [t]x R K1^-1`` of the cameras ``X2 = R X1 + t``; R (*B, 3, 3), t (*B, 3). Source:
    ibid., eq. 9.2."""
    check_matrices(R=R)
    return fundamental_from_essential(hat(t) @ R, K1, K2)


def epipolar_lines(F: Tensor, x: Tensor) -> Tensor:
    """The lines ``F x`` in the other image: (*B, N, 3) ``(a, b, c)``, ``a u + b v + c = 0`` with
    ``a² + b² = 1``.

    The value of the line at a pixel is then its signed distance in pixels.

    Args:
        F: (*B, 3, 3); for lines in image 1 of points of image 2 pass ``F.mT``.
        x: (*B, N, 2) pixels.

    Returns:
        Lines; that of the epipole itself, which has none, is zero.
    """
    check_points(x=x)
    check_matrices(x, F=F)
    lines = to_homogeneous(x) @ F.mT
    square = (lines[..., :2] ** 2).sum(-1, keepdim=True)
    return torch.where(square > 0, lines / torch.where(square > 0, square, 1.0).sqrt(), 0.0)


def epipoles(F: Tensor) -> tuple[Tensor, Tensor]:
    """The epipoles ``F e1 = 0`` and ``F^T e2 = 0``: (*B, 3) each, homogeneous pixels of unit
    length.

    Homogeneous because they may lie at infinity (sideways motion); the sign is arbitrary.
    """
    check_matrices(F=F)
    wide = unit_norm(F.double())
    e1, _ = smallest_singular_vector(wide)
    e2, _ = smallest_singular_vector(wide.mT)
    return e1.to(F.dtype), e2.to(F.dtype)


def sampson_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Signed first-order distance of a match to the epipolar geometry, in pixels: (*B, N).

    ``x2^T F x1 / sqrt((F x1)_1² + (F x1)_2² + (F^T x2)_1² + (F^T x2)_2²)``: how far the four
    coordinates of the match have to move, together, to meet the constraint. Zero where both points
    are the epipoles.

    Args:
        F: (*B, 3, 3) of any scale; (*B, 1) hypotheses broadcast against shared points.
        x1, x2: (*B, N, 2) pixels.

    Source: Hartley & Zisserman, eq. 11.9; Sampson, "Fitting conic sections to very scattered data",
    1982.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, F=F)
    return _sampson(F, x1, x2)


def _sampson(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    r, (a, b), (c, d) = _residual_and_lines(F, x1, x2)
    square = a * a + b * b + c * c + d * d
    return r / torch.where(square > 0, square, 1.0).sqrt()


def squared_sampson_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N) square of :func:`sampson_distance`, square pixels."""
    return sampson_distance(F, x1, x2) ** 2


def symmetric_epipolar_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N) squared distance of x2 to the line of x1 plus that of x1 to the line of x2, square
    pixels.

    Args as for :func:`sampson_distance`. Source: Hartley & Zisserman, eq. 11.10.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, F=F)
    r, (a, b), (c, d) = _residual_and_lines(F, x1, x2)
    in2, in1 = a * a + b * b, c * c + d * d
    return r * r * (1 / torch.where(in2 > 0, in2, 1.0) + 1 / torch.where(in1 > 0, in1, 1.0))


Pair = tuple[Tensor, Tensor]


def _residual_and_lines(F: Tensor, x1: Tensor, x2: Tensor) -> tuple[Tensor, Pair, Pair]:
    """``x2^T F x1`` and the first two coordinates of the lines ``F x1`` and ``F^T x2``; each (*B,
    N)."""
    f = F.unsqueeze(-1)
    u1, v1 = x1[..., 0], x1[..., 1]
    u2, v2 = x2[..., 0], x2[..., 1]
    a, b, c = (f[..., i, 0, :] * u1 + f[..., i, 1, :] * v1 + f[..., i, 2, :] for i in range(3))
    d, e = (f[..., 0, j, :] * u2 + f[..., 1, j, :] * v2 + f[..., 2, j, :] for j in range(2))
    return u2 * a + v2 * b + c, (a, b), (d, e)
