"""Rotations SO(3) and unit directions S^2, the two manifolds of a relative pose.

A small change of the pose consists of five numbers ``(omega, b)``: ``R <- exp(omega) R`` with a
rotation vector omega in radians, and ``t <- exp_t(B b)`` with an orthonormal basis B of the plane
that is tangent to the sphere at t.

The functions run in the inner loops of the refinements and check only shapes and types; NaN input
gives NaN output.
"""

from __future__ import annotations

import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from kornia.geometry.epipolar import cross_product_matrix
from torch import Tensor

from .checks import check_shapes

_SERIES = 1e-3  # below this squared angle, Taylor series to the 8th power are exact in float64


def hat(w: Tensor) -> Tensor:
    """Return ``[w]x (*B, 3, 3)`` with ``[w]x v = w x v``, for w ``(*B, 3)``.

    Computed by kornia's ``cross_product_matrix``.
    """
    check_shapes((3,), w=w)
    return cross_product_matrix(w)


def so3_exp(w: Tensor) -> Tensor:
    """Return the rotation by |w| radians about w: ``(*B, 3)`` to ``(*B, 3, 3)``.

    The function is smooth everywhere, including zero. Computed by kornia's
    ``axis_angle_to_rotation_matrix``.

    Source: Rodrigues' formula; Hartley and Zisserman, 2nd ed., appendix A4.3.2.
    """
    check_shapes((3,), w=w)
    return axis_angle_to_rotation_matrix(w)


def so3_log(R: Tensor) -> Tensor:
    """Return the rotation vector, |w| <= pi, of R: ``(*B, 3, 3)`` to ``(*B, 3)``.

    The function is accurate and smooth at the identity. It is computed from the unit quaternion,
    whose outer product with itself is linear in R. The largest column of that product is well away
    from zero for every R, including rotations by 180 degrees (where w is discontinuous).

    kornia's ``rotation_matrix_to_axis_angle`` (0.9.0) is not used because its second derivative at
    the identity is wrong (gradgradcheck fails; see ``tests/geometry/test_kornia.py``).

    Source: Bar-Itzhack, New method for extracting the quaternion from a rotation matrix, JGCD 2000
    (the matrix).
    """
    check_shapes((3, 3), R=R)
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in R.unbind(-2))
    outer = torch.stack(
        (
            torch.stack((1 + a + e + i, h - f, c - g, d - b), -1),
            torch.stack((h - f, 1 + a - e - i, b + d, c + g), -1),
            torch.stack((c - g, b + d, 1 - a + e - i, f + h), -1),
            torch.stack((d - b, c + g, f + h, 1 - a - e + i), -1),
        ),
        -2,
    )
    largest = outer.diagonal(dim1=-2, dim2=-1).argmax(-1)
    q = torch.take_along_dim(outer, largest[..., None, None], -1)[..., 0]
    q = q / q.norm(dim=-1, keepdim=True)
    q = torch.where(q[..., :1] < 0, -q, q)
    s, v = q[..., 0], q[..., 1:]
    square = (v * v).sum(-1)
    small = square < _SERIES
    length = torch.where(small, 1.0, square).sqrt()
    # Square of the tangent of half the angle; used only where it is small.
    u = square / torch.where(small, s * s, 1.0)
    series = (
        2 / torch.where(small, s, 1.0) * (1 - u / 3 + u * u / 5 - u**3 / 7 + u**4 / 9 - u**5 / 11)
    )
    return torch.where(small, series, 2 * torch.atan2(length, s) / length)[..., None] * v


def tangent_basis(t: Tensor) -> Tensor:
    """Return an orthonormal basis ``(*B, 3, 2)`` of the plane perpendicular to t ``(*B, 3)``.

    t, b1, b2 form a right-handed system. The basis is continuous except where the axis with the
    smallest component of t changes. kornia 0.9.0 has no counterpart.

    Source: Hartley and Zisserman, 2nd ed., appendix A4.1.2 (a Householder reflection that maps t to
    an axis).
    """
    check_shapes((3,), t=t)
    t = t / t.norm(dim=-1, keepdim=True)
    axis = (torch.arange(3, device=t.device) == t.detach().abs().argmin(-1, keepdim=True)).to(
        t.dtype
    )
    b1 = torch.linalg.cross(t, axis, dim=-1)
    b1 = b1 / b1.norm(dim=-1, keepdim=True)
    return torch.stack((b1, torch.linalg.cross(t, b1, dim=-1)), -1)


def sphere_exp(t: Tensor, v: Tensor) -> Tensor:
    """Move from unit t by |v| radians along the great circle in the tangent direction v.

    t and v are ``(*B, 3)``. kornia 0.9.0 has no counterpart.
    """
    check_shapes((3,), t=t, v=v)
    square = (v * v).sum(-1, keepdim=True)
    small = square < _SERIES
    angle = torch.where(small, 1.0, square).sqrt()
    s = torch.where(
        small, 1 - square / 6 * (1 - square / 20 * (1 - square / 42)), angle.sin() / angle
    )
    c = torch.where(small, 1 - square / 2 * (1 - square / 12 * (1 - square / 30)), angle.cos())
    moved = c * t + s * v
    return moved / moved.norm(dim=-1, keepdim=True)
