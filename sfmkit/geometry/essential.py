"""The essential matrix, ``xn2^T E xn1 = 0`` in normalised coordinates: its manifold, its poses, and
where it comes from."""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import InputError
from ._checks import check_intrinsics, check_matrices, check_points
from ._five_point import five_point, one_pose, rotated, rotation_step
from ._nullspace import detached, smallest_singular_vector
from .fundamental import cofactors, slots
from .lie import hat


def essential_from_pose(R: Tensor, t: Tensor) -> Tensor:
    """``E = [t]x R`` of the cameras ``X2 = R X1 + t``; R (*B, 3, 3), t (*B, 3). Source: Hartley &
    Zisserman 9.6."""
    check_matrices(t, R=R)
    return hat(t) @ R


def essential_from_fundamental(F: Tensor, K1: Tensor, K2: Tensor) -> Tensor:
    """``K2^T F K1``, projected to the essential manifold: (*B, 3, 3), Frobenius norm √2.

    Source: Hartley & Zisserman, eq. 9.12.
    """
    check_matrices(F=F)
    check_intrinsics(F, K1=K1, K2=K2)
    return project_to_essential(K2.mT @ F @ K1)


def project_to_essential(E: Tensor) -> Tensor:
    """The essential matrix nearest in direction to E: singular values (1, 1, 0), that is Frobenius
    norm √2.

    With u, v the left and right null vectors of the rank-two part E', ``E' + [u]x E' [v]x^T`` has
    its two singular values
    averaged: no SVD is differentiated, so the derivative is finite on the manifold itself (there
    ``kornia.geometry.epipolar`` gives NaN).

    Args:
        E: (*B, 3, 3), any scale.

    Source: Hartley & Zisserman 11.7.3 (what); for the closed form see above.
    """
    check_matrices(E=E)
    P, _ = _project(E.double())
    return P.to(E.dtype)


def _project(E: Tensor) -> tuple[Tensor, Tensor]:
    """The projection, and the unit left null vector u (the translation up to its sign)."""
    E = E / E.detach().flatten(-2).norm(dim=-1)[..., None, None].clamp(
        min=torch.finfo(E.dtype).tiny
    )
    v, _ = smallest_singular_vector(E)
    u, _ = smallest_singular_vector(E.mT)
    E = E - (E @ v[..., None]) * v[..., None, :]
    swapped = hat(u) @ E @ hat(v).mT
    sign = torch.where((E * swapped).sum((-2, -1), keepdim=True) < 0, -1.0, 1.0).detach()
    P = E + sign * swapped
    size = P.flatten(-2).norm(dim=-1)[..., None, None]
    return P * (2**0.5 / torch.where(size > 0, size, 1.0)), u


def decompose_essential(E: Tensor) -> tuple[Tensor, Tensor]:
    """The four poses ``X2 = R X1 + t`` that E allows, two rotations times two signs of t.

    ``R = cof(E) ∓ [t]x E`` for unit t: closed form, no SVD; finite derivatives at an exact E.

    Args:
        E: (*B, 3, 3), any scale and sign; projected to the essential manifold first.

    Returns:
        R: (*B, 4, 3, 3), the order R1, R1, R2, R2.
        t: (*B, 4, 3) unit, the order t, -t, t, -t; the first has its largest component positive.

    Source: Horn, "Recovering baseline and orientation from essential matrix", 1990.
    """
    check_matrices(E=E)
    P, t = _project(E.double())
    largest = torch.take_along_dim(t.detach(), t.detach().abs().argmax(-1, keepdim=True), -1)
    t = t * torch.where(largest < 0, -1.0, 1.0)
    C, tE = cofactors(P), hat(t) @ P
    R1, R2 = C - tE, C + tE
    return torch.stack((R1, R1, R2, R2), -3).to(E.dtype), torch.stack((t, -t, t, -t), -2).to(
        E.dtype
    )


def essential_5point(xn1: Tensor, xn2: Tensor) -> tuple[Tensor, Tensor]:
    """All real essential matrices of five matches.

    Differentiated implicitly: the solver's own steps are constants, and each solution moves on the
    essential manifold so that the five constraints stay met (implicit function theorem).

    Args:
        xn1, xn2: (*B, 5, 2) normalised coordinates.

    Returns:
        E: (*B, 10, 3, 3), each of Frobenius norm √2 (unit translation) and arbitrary sign; zero
            where there is none.
        valid: (*B, 10) bool, the solutions first.

    Raises:
        InputError: not exactly 5 matches; shapes, dtypes, devices, NaN.

    Source: Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004; the
    degree-ten polynomial is evaluated on the circle and its roots bracketed there (see ``_roots``)
    instead of Sturm's sequence. On 5000 exact samples the true E is missed (by more than 1e-6) in
    0.02 % under sideways and 0.28 % under forward motion; by
    ``kornia.geometry.epipolar.find_essential`` in 0.10 % and 1.72 %.
    """
    check_points(5, xn1=xn1, xn2=xn2)
    if xn1.shape[-2] != 5:
        raise InputError(f"the five-point algorithm needs exactly 5 matches, not {xn1.shape[-2]}")
    x1, x2 = xn1.double(), xn2.double()
    E, valid = detached(_all_solutions, x1, x2)
    a, b = rotation_step(E, x1[..., None, :, :], x2[..., None, :, :], valid)
    return (E + hat(a) @ E + E @ hat(b)).to(xn1.dtype), valid


def _all_solutions(x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor]:
    """(*B, 10, 3, 3) solutions, polished, and which of the ten slots hold one."""
    batch = x1.shape[:-2]
    x1, x2 = x1.reshape(-1, 5, 2), x2.reshape(-1, 5, 2)
    raw, owner = five_point(x1, x2, cells=1536)
    R, t = one_pose(raw)
    E = hat(t) @ R
    moved = torch.minimum((E - raw).abs().amax((-2, -1)), (E + raw).abs().amax((-2, -1)))
    for _ in range(3):
        a, b = rotation_step(E, x1[owner], x2[owner])
        E = rotated(E, a, b)
        moved = moved + a.abs().amax(-1)
    # What a degenerate sample leaves behind is not a solution: it is not finite, went far, or still
    # moves.
    good = (moved < 1e-2) & (a.abs().amax(-1) < 1e-6) & E.isfinite().all(-1).all(-1)
    return slots(E[good], owner[good], len(x1), 10, batch)
