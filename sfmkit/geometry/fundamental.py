"""The fundamental matrix, ``x2^T F x1 = 0`` in pixels."""

from __future__ import annotations

import torch
from kornia.geometry import epipolar
from torch import Tensor

from ..errors import InputError
from . import kernels
from ._nullspace import detached, smallest_singular_vector
from .checks import (
    check_determined,
    check_intrinsics,
    check_matrices,
    check_nonzero,
    check_points,
)
from .essential import essential_from_pose


def fundamental_8point(x1: Tensor, x2: Tensor, weights: Tensor | None = None) -> Tensor:
    """Estimate F from 8 or more matches: normalised linear least squares, then rank 2.

    kornia's ``find_fundamental`` (0.9.0) is less accurate: on 500 exact sets of 20 matches, its
    median error is 6e-14 and that of this function 2e-15; with the depth of the scene reduced to
    1e-4, the errors are 2e-6 and 9e-12 (``benchmarks/geometry.py --peers``). kornia takes 0.8 of
    the time on 20,000 matches.

    Args:
        x1, x2: (*B, N, 2) pixels, N >= 8.
        weights: (*B, N) or (N,) weights of the squared algebraic residuals.

    Returns:
        (*B, 3, 3) of unit Frobenius norm, rank 2 and arbitrary sign. Float32 input is computed in
        float64.

    Raises:
        DegenerateGeometryError: There are fewer than 8 matches, or they do not determine F because
            they are coplanar, collinear or repeated. In a batch, the error is raised only if this
            holds for all members; if it holds for some, their F is finite but meaningless.
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.

    Source: Hartley & Zisserman 11.2, algorithm 11.1.
    """
    check_points(8, weights, x1=x1, x2=x2)
    dtype = x1.dtype
    x1, x2 = x1.double(), x2.double()
    weights = None if weights is None else weights.double()
    n1, T1 = kernels.hartley(x1, weights)
    n2, T2 = kernels.hartley(x2, weights)
    f, gap = smallest_singular_vector(kernels.epipolar_rows(n1, n2), weights)
    check_determined(gap, dtype, "F", "they may lie on one plane, on one line, or be repeated")
    F = T2.mT @ _rank2(f.unflatten(-1, (3, 3))) @ T1
    return kernels.unit_norm(F).to(dtype)


def fundamental_7point(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """Return all real fundamental matrices of seven matches.

    kornia's ``find_fundamental`` gives the solutions, which are polished as constants. Two further
    steps of Newton's method carry the derivatives (first and second order are correct), so the
    function also works in batches ``*B`` and under ``torch.func.vmap``.

    Args:
        x1, x2: (*B, 7, 2) pixels.

    Returns:
        F (*B, 3, 3, 3), one to three solutions of unit Frobenius norm, rank 2 and arbitrary sign,
        zero where there is no solution; and valid (*B, 3) bool. The solutions come first.

    Raises:
        InputError: There are not exactly 7 matches, shapes, dtypes or devices do not fit, or a
            value is NaN.

    Source: Hartley & Zisserman 11.1.2.
    """
    check_points(7, x1=x1, x2=x2)
    if x1.shape[-2] != 7:
        raise InputError(f"the seven-point algorithm needs exactly 7 matches, not {x1.shape[-2]}")
    dtype = x1.dtype
    (n1, T1), (n2, T2) = kernels.hartley(x1.double()), kernels.hartley(x2.double())
    F, valid = detached(_all_solutions, n1, n2)
    rows = kernels.epipolar_rows(n1, n2)[..., None, :, :]
    for _ in range(2):
        F = F - _seven_point_step(F, rows, valid)
    F = T2.mT[..., None, :, :] @ F @ T1[..., None, :, :]
    found = valid[..., None, None]
    F = torch.where(found, kernels.unit_norm(torch.where(found, F, 1.0)), 0.0)
    return F.to(dtype), valid


def _all_solutions(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """Return polished solutions (*B, 3, 3, 3) and a mask (*B, 3) of the slots in use."""
    batch = x1.shape[:-2]
    x1, x2 = x1.reshape(-1, 7, 2), x2.reshape(-1, 7, 2)
    F, valid = kernels.fundamental_candidates(x1, x2)
    step = _seven_point_step(F, kernels.epipolar_rows(x1, x2)[:, None], valid)
    valid = valid & step.isfinite().flatten(-2).all(-1)
    F, valid = kernels.solutions_first(F - torch.where(valid[..., None, None], step, 0.0), valid)
    return F.reshape(*batch, 3, 3, 3), valid.reshape(*batch, 3)


def _seven_point_step(F: Tensor, rows: Tensor, valid: Tensor) -> Tensor:
    """Return the Newton step for F: seven matches, a zero determinant, a fixed norm."""
    f = F.flatten(-2)[..., None]
    minors = kernels.cofactors(F)
    rows = rows.expand(*F.shape[:-2], 7, 9)
    J = torch.cat((rows, minors.flatten(-2)[..., None, :], f.detach().mT), -2)
    determinant = (F[..., 0, :] * minors[..., 0, :]).sum(-1)[..., None, None]
    value = torch.cat((rows @ f, determinant, torch.zeros_like(determinant)), -2)
    J = torch.where(valid[..., None, None], J, torch.eye(9, dtype=F.dtype, device=F.device))
    return torch.linalg.solve_ex(J, value)[0].unflatten(-2, (3, 3)).squeeze(-1)


def _rank2(F: Tensor) -> Tensor:
    """Return the nearest singular matrix, ``F - (F v) v^T`` with v the last singular vector.

    This is equivalent to setting the smallest singular value to zero, but the derivative is finite
    even if that value is already zero.
    """
    v, _ = smallest_singular_vector(F)
    return F - (F @ v[..., None]) * v[..., None, :]


def fundamental_from_essential(E: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Return ``F = K2^-T E K1^-1``, (*B, 3, 3), not rescaled. Computed by kornia.

    Source: Hartley & Zisserman, eq. 9.12.
    """
    check_matrices(E=E)
    check_intrinsics(E, K1=K1, K2=K2)
    ndim = max(E.ndim, K1.ndim, K2.ndim)
    E, K1, K2 = (M[(None,) * (ndim - M.ndim)] for M in (E, K1, K2))
    return epipolar.fundamental_from_essential(E, K1, K2)


def fundamental_from_pose(R: Tensor, t: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Return ``F = K2^-T [t]x R K1^-1`` of the cameras ``X2 = R X1 + t``. Computed by kornia.

    Args:
        R: (*B, 3, 3). t: (*B, 3). K1, K2: (*B, 3, 3).

    Source: Hartley & Zisserman, eq. 9.2.
    """
    return fundamental_from_essential(essential_from_pose(R, t), K1, K2)


def fundamental_from_projections(P1: Tensor, P2: Tensor) -> Tensor:
    """Return F (*B, 3, 3) of two projection matrices (*B, 3, 4), not rescaled.

    Computed by kornia.

    Source: Hartley & Zisserman, eq. 17.3.
    """
    check_matrices(shape=(3, 4), P1=P1, P2=P2)
    batch = torch.broadcast_shapes(P1.shape[:-2], P2.shape[:-2])
    return epipolar.fundamental_from_projections(P1.expand(*batch, 3, 4), P2.expand(*batch, 3, 4))


def epipolar_lines(F: Tensor, x: Tensor) -> Tensor:
    """Return the epipolar lines ``F x`` in the other image.

    Computed by kornia's ``compute_correspond_epilines``.

    Args:
        F: (*B, 3, 3); for lines in image 1 of points of image 2, pass ``F.mT``.
        x: (*B, N, 2) pixels.

    Returns:
        (*B, N, 3) lines ``(a, b, c)`` with ``a² + b² = 1``, so that ``a u + b v + c`` is the signed
        distance of a pixel (u, v) from the line, in pixels. The epipole itself has no line and
        gives zeros.
    """
    check_points(x=x)
    check_matrices(x, F=F)
    return epipolar.compute_correspond_epilines(x, F)


def epipoles(F: Tensor) -> tuple[Tensor, Tensor]:
    """Return the epipoles, ``F e1 = 0`` and ``F^T e2 = 0``: (*B, 3) unit homogeneous pixels.

    Homogeneous coordinates represent epipoles at infinity (sideways motion); the sign is arbitrary.
    kornia 0.9.0 has no public function for the epipoles.

    Raises:
        DegenerateGeometryError: F is zero.
    """
    check_matrices(F=F)
    check_nonzero(F=F)
    wide = kernels.unit_norm(F.double())
    e1, _ = smallest_singular_vector(wide)
    e2, _ = smallest_singular_vector(wide.mT)
    return e1.to(F.dtype), e2.to(F.dtype)


def signed_sampson_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return the signed first-order distance of matches to the epipolar geometry, in pixels.

    ``x2^T F x1 / sqrt((F x1)_1² + (F x1)_2² + (F^T x2)_1² + (F^T x2)_2²)`` is the length of the
    smallest joint displacement of both points that satisfies the epipolar constraint, to first
    order. It is zero where both points are the epipoles. kornia 0.9.0 has only the unsigned
    distance.

    Args:
        F: (*B, 3, 3) of any scale; hypotheses (*B, 1, 3, 3) broadcast against shared points.
        x1, x2: (*B, N, 2) pixels.

    Returns:
        (*B, N) signed distances in pixels.

    Source: Hartley & Zisserman, eq. 11.9; Sampson, "Fitting conic sections to very scattered data",
    1982.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, F=F)
    return kernels.signed_sampson(F, x1, x2)


def squared_sampson_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return the square of :func:`signed_sampson_distance`, (*B, N) square pixels.

    Computed by kornia's ``sampson_epipolar_distance``.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, F=F)
    return epipolar.sampson_epipolar_distance(x1, x2, F, squared=True)


def squared_symmetric_epipolar_distance(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return the sum of the squared distances from both epipolar lines, (*B, N) square pixels.

    The sum consists of the squared distance of x2 from the line of x1 and that of x1 from the line
    of x2. Arguments are those of :func:`signed_sampson_distance`. Computed by kornia's
    ``symmetrical_epipolar_distance``.

    Source: Hartley & Zisserman, eq. 11.10.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, F=F)
    return epipolar.symmetrical_epipolar_distance(x1, x2, F, squared=True)
