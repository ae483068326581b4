"""Radial-tangential lens distortion in normalised coordinates, and its inverse.

Source: Brown, Close-range camera calibration, 1971; coefficients ``k1, k2, p1, p2, k3`` in OpenCV's
order.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ._checks import _traced, check_matrices, check_points

_SEARCH_STEPS = 10  # Newton doubles the digits each step; strong wide-angle distortion needs seven
_TOLERANCE = (
    1e-10  # largest distance, in focal lengths, between the point and the image of its inverse
)


def distort(xn: Tensor, d: Tensor) -> Tensor:
    """Where a lens puts the points of an ideal pinhole camera, ``(*B, N, 2)``, normalised
    coordinates.

    Args:
        xn: ``(*B, N, 2)`` normalised coordinates without distortion.
        d: ``(*B, 5)`` coefficients k1, k2, p1, p2, k3.

    Raises:
        InputError: on shapes, dtypes or devices that do not fit, or NaN.
    """
    check_points(xn=xn)
    check_matrices(xn, shape=(5,), d=d)
    return torch.stack(_distort(xn[..., 0], xn[..., 1], d)[:2], -1)


def undistort(xn: Tensor, d: Tensor) -> Tensor:
    """The ideal pinhole points that the lens put at xn, ``(*B, N, 2)``: the inverse of
    :func:`distort`.

    Newton's method on the two equations of a point, exact to rounding (float32 input is worked in
    float64). The iterations are not recorded; the last two steps are, and give derivatives by xn
    and d up to the third order, whatever the number of iterations before (implicit function
    theorem).

    Args:
        xn: ``(*B, N, 2)`` normalised coordinates with distortion.
        d: ``(*B, 5)`` coefficients k1, k2, p1, p2, k3.

    Raises:
        InputError: also where the lens model cannot be inverted: points beyond the radius at which
            it folds back.
    """
    check_points(xn=xn)
    check_matrices(xn, shape=(5,), d=d)
    target, coefficients = xn.double(), d.double()
    u, v = target.unbind(-1)
    x, y = u.detach(), v.detach()
    for _ in range(_SEARCH_STEPS):
        x, y = _newton_step(x, y, u.detach(), v.detach(), coefficients.detach())
    for _ in range(2):
        x, y = _newton_step(x, y, u, v, coefficients)
    found = torch.stack((x, y), -1)
    if not _traced():
        _check_inverse(found.detach(), target.detach(), coefficients.detach())
    return found.to(xn.dtype)


def _check_inverse(x: Tensor, target: Tensor, d: Tensor) -> None:
    """Raise InputError where x does not lead back to its target, or lies where the image has folded
    back on itself."""
    u, v, _ = _distort(x[..., 0], x[..., 1], d)
    miss = torch.maximum((u - target[..., 0]).abs(), (v - target[..., 1]).abs())
    # The image grows with the radius while 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 > 0, s the squared
    # radius.
    folds = []
    for k1, k2, _, _, k3 in d.reshape(-1, 5).tolist():
        roots = np.roots((7 * k3, 5 * k2, 3 * k1, 1.0))
        folds.append(min((r.real for r in roots if r.imag == 0 and r.real > 0), default=math.inf))
    fold = torch.tensor(folds, dtype=x.dtype, device=x.device).reshape(d.shape[:-1])
    lost = ~(miss < _TOLERANCE) | ((x * x).sum(-1) > fold[..., None])
    if bool(lost.any()):
        raise InputError(
            f"{int(lost.sum())} of {lost.numel()} points lie outside the field that the distortion {d.tolist()} "
            "describes: check its order (k1, k2, p1, p2, k3) and K, or drop those points"
        )


def _distort(
    x: Tensor, y: Tensor, d: Tensor
) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor, Tensor, Tensor]]:
    """The distorted point and the Jacobian ``(du/dx, du/dy, dv/dx, dv/dy)``, components
    ``(*B, N)``."""
    k1, k2, p1, p2, k3 = (d[..., i, None] for i in range(5))
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3))  # d radial / dx = slope x
    u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    mixed = x * y * slope + 2 * (p1 * x + p2 * y)
    return (
        u,
        v,
        (
            radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
            mixed,
            mixed,
            radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
        ),
    )


def _newton_step(x: Tensor, y: Tensor, u0: Tensor, v0: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    u, v, (a, b, _, c) = _distort(x, y, d)
    determinant = a * c - b * b
    determinant = torch.where(determinant == 0, 1.0, determinant)
    du, dv = u - u0, v - v0
    return x - (c * du - b * dv) / determinant, y - (a * dv - b * du) / determinant
