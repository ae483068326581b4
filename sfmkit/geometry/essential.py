"""The essential matrix, ``xn2^T E xn1 = 0`` in normalised coordinates."""

from __future__ import annotations

import torch
from kornia.geometry import epipolar
from torch import Tensor

from ..errors import InputError
from . import kernels
from ._nullspace import detached, smallest_singular_vector
from .checks import check_intrinsics, check_matrices, check_nonzero, check_points
from .lie import hat, so3_exp


def essential_from_pose(R: Tensor, t: Tensor) -> Tensor:
    """Return ``E = [t]x R`` of the cameras ``X2 = R X1 + t``; R (*B, 3, 3), t (*B, 3).

    Computed by kornia's ``essential_from_Rt`` with camera 1 at the origin.

    Source: Hartley & Zisserman 9.6.
    """
    check_matrices(R=R)
    check_matrices(R, shape=(3,), t=t)
    batch = torch.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    R, t = R.expand(*batch, 3, 3), t.expand(*batch, 3)[..., None]
    eye = torch.eye(3, dtype=R.dtype, device=R.device).expand_as(R)
    return epipolar.essential_from_Rt(eye, torch.zeros_like(t), R, t)


def essential_from_fundamental(F: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """Return ``K2^T F K1``, projected to the essential manifold.

    The result (*B, 3, 3) has the Frobenius norm √2. The product is computed by kornia's
    ``essential_from_fundamental``; see :func:`project_to_essential` for the projection.

    Raises:
        DegenerateGeometryError: F is zero.

    Source: Hartley & Zisserman, eq. 9.12.
    """
    check_matrices(F=F)
    check_intrinsics(F, K1=K1, K2=K2)
    return project_to_essential(epipolar.essential_from_fundamental(F, K1, K2))


def project_to_essential(E: Tensor) -> Tensor:
    """Return the essential matrix nearest in direction to E: singular values (1, 1, 0).

    Let u and v be the left and right null vectors of the rank-two part E'. Both non-zero singular
    values of ``E' + [u]x E' [v]x^T`` are then the sum of the two singular values of E'. No SVD is
    differentiated, so the derivatives are finite on the manifold itself, where those of kornia's
    ``project_to_essential`` (0.9.0) are not (``tests/geometry/test_kornia.py`` shows it).

    Args:
        E: (*B, 3, 3), any scale.

    Returns:
        (*B, 3, 3) of Frobenius norm √2.

    Raises:
        DegenerateGeometryError: E is zero.
        InputError: The shape or dtype is wrong, or a value is NaN.

    Source: Hartley & Zisserman 11.7.3 (the definition).
    """
    check_matrices(E=E)
    check_nonzero(E=E)
    P, _ = _project(E.double())
    return P.to(E.dtype)


def _project(E: Tensor) -> tuple[Tensor, Tensor]:
    """Return the projection and its unit left null vector, the translation up to sign."""
    tiny = torch.finfo(E.dtype).tiny
    E = E / E.detach().flatten(-2).norm(dim=-1)[..., None, None].clamp(min=tiny)
    v, _ = smallest_singular_vector(E)
    E = E - (E @ v[..., None]) * v[..., None, :]
    # The cofactors of a matrix of rank two are the product u v^T of its null vectors, scaled.
    u = (kernels.cofactors(E) @ v[..., None]).squeeze(-1)
    square = (u * u).sum(-1, keepdim=True)
    u = u / torch.where(square > 0, square, 1.0).sqrt()
    P = E + hat(u) @ E @ hat(v).mT
    size = P.flatten(-2).norm(dim=-1)[..., None, None]
    return P * (2**0.5 / torch.where(size > 0, size, 1.0)), u


def decompose_essential(E: Tensor) -> tuple[Tensor, Tensor]:
    """Return the four poses ``X2 = R X1 + t`` of E: two rotations times two signs of t.

    The closed form ``R = cof(E) ∓ [t]x E`` for unit t needs no SVD, and its derivatives are finite
    at an exact E. kornia's ``motion_from_essential`` (0.9.0) has non-finite gradients there, and
    its ``decompose_essential_matrix_no_svd`` fails under ``torch.func.vmap``
    (``tests/geometry/test_kornia.py`` shows both).

    Args:
        E: (*B, 3, 3) of any scale and sign; it is first projected to the essential manifold.

    Returns:
        R (*B, 4, 3, 3), in the order R1, R1, R2, R2, and unit t (*B, 4, 3), in the order t, -t, t,
        -t. The largest component of the first t is positive.

    Raises:
        DegenerateGeometryError: E is zero.
        InputError: The shape or dtype is wrong, or a value is NaN.

    Source: Horn, "Recovering baseline and orientation from essential matrix", 1990.
    """
    check_matrices(E=E)
    check_nonzero(E=E)
    P, t = _project(E.double())
    largest = torch.take_along_dim(t.detach(), t.detach().abs().argmax(-1, keepdim=True), -1)
    t = t * torch.where(largest < 0, -1.0, 1.0)
    C, tE = kernels.cofactors(P), hat(t) @ P
    R1, R2 = C - tE, C + tE
    R4, t4 = torch.stack((R1, R1, R2, R2), -3), torch.stack((t, -t, t, -t), -2)
    return R4.to(E.dtype), t4.to(E.dtype)


def essential_5point(xn1: Tensor, xn2: Tensor) -> tuple[Tensor, Tensor]:
    """Return all real essential matrices of five matches.

    kornia's ``find_essential`` gives the candidates, which are polished on the essential manifold.
    The polished solutions are constants; two further steps of Newton's method carry the derivatives
    (first and second order are correct). In 20,000 exact samples, the true E is missed by more than
    1e-6 in 0.01 % (sideways motion) and 0.06 % (forward motion); without polishing (kornia 0.9.0),
    in 0.12 % and 1.2 % (``benchmarks/geometry.py --peers``). Polishing takes twice kornia's own
    time; the robust search calls kornia's solver directly.

    Args:
        xn1, xn2: (*B, 5, 2) normalised coordinates.

    Returns:
        E (*B, 10, 3, 3), each of Frobenius norm √2 (unit translation) and arbitrary sign, zero
        where there is no solution; and valid (*B, 10) bool. The solutions come first.

    Raises:
        InputError: There are not exactly 5 matches, shapes, dtypes or devices do not fit, or a
            value is NaN.

    Source: Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004.
    """
    check_points(5, xn1=xn1, xn2=xn2)
    if xn1.shape[-2] != 5:
        raise InputError(f"the five-point algorithm needs exactly 5 matches, not {xn1.shape[-2]}")
    x1, x2 = xn1.double(), xn2.double()
    E, valid = detached(_all_solutions, x1, x2)
    x1, x2 = x1[..., None, :, :], x2[..., None, :, :]
    for _ in range(2):
        E = _newton_step(E, x1, x2, valid)[0]
    return E.to(xn1.dtype), valid


def _all_solutions(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """Return polished solutions (*B, 10, 3, 3) and a mask (*B, 10) of the slots in use."""
    batch = x1.shape[:-2]
    x1, x2 = x1.reshape(-1, 5, 2), x2.reshape(-1, 5, 2)
    slots, valid = kernels.essential_candidates(x1, x2)
    raw, owner = slots[valid], valid.nonzero()[:, 0]
    R, t = kernels.one_pose(raw)
    E = hat(t) @ R
    moved = torch.minimum((E - raw).abs().amax((-2, -1)), (E + raw).abs().amax((-2, -1)))
    step = moved
    for _ in range(4):
        E, step = _newton_step(E, x1[owner], x2[owner])
        moved = moved + step
    # Candidates of a degenerate sample are not finite, moved far, or have not converged.
    good = (moved < 1e-2) & (step < 1e-6) & E.isfinite().flatten(-2).all(-1)
    slots[valid], valid[valid.clone()] = E, good
    E, valid = kernels.solutions_first(slots, valid)
    return E.reshape(*batch, 10, 3, 3), valid.reshape(*batch, 10)


def _newton_step(
    E: Tensor, x1: Tensor, x2: Tensor, valid: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Move E along the essential manifold to satisfy the five constraints to first order.

    The new E is ``exp([a]) E exp([b])`` with the smallest rotation vectors a and b. Rotations from
    the left and from the right reach every neighbour of E on the manifold. (They have six numbers,
    one more than the dimension of the manifold.)

    Args:
        E: (*B, 3, 3).
        x1, x2: (*B, 5, 2) normalised coordinates.
        valid: (*B,) bool; the other members stay unchanged.

    Returns:
        The new E, and the largest component of ``|a|`` (*B,).
    """
    h1, h2 = (torch.nn.functional.pad(x, (0, 1), value=1.0) for x in (x1, x2))
    lines2, lines1 = h1 @ E.mT, h2 @ E
    residual = (lines2 * h2).sum(-1)
    turns = (
        torch.linalg.cross(lines2, h2.expand_as(lines2), dim=-1),
        torch.linalg.cross(h1.expand_as(lines1), lines1, dim=-1),
    )
    J = torch.cat(turns, -1)
    gram = J @ J.mT
    if valid is not None:
        eye = torch.eye(5, dtype=E.dtype, device=E.device)
        gram = torch.where(valid[..., None, None], gram, eye)
    solution, _ = torch.linalg.solve_ex(gram, residual[..., None])
    step = -(J.mT @ solution).squeeze(-1)
    a, b = step[..., :3], step[..., 3:]
    return so3_exp(a) @ E @ so3_exp(b), a.abs().amax(-1)
