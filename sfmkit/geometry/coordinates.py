"""Homogeneous coordinates, pixels and normalised coordinates, and Hartley's normalisation."""

from __future__ import annotations

import torch
from kornia.geometry.conversions import (
    convert_points_to_homogeneous,
    denormalize_points_with_intrinsics,
)
from torch import Tensor

from ..errors import InputError
from . import kernels
from .checks import check_intrinsics, check_points


def to_homogeneous(x: Tensor) -> Tensor:
    """Append a 1 to points: (*B, N, D) -> (*B, N, D + 1).

    Computed by kornia's ``convert_points_to_homogeneous``.
    """
    if x.ndim < 2:
        raise InputError(f"points must have shape (*B, N, D), not {tuple(x.shape)}")
    return convert_points_to_homogeneous(x)


def from_homogeneous(xh: Tensor) -> Tensor:
    """Divide by the last coordinate: (*, D + 1) -> (*, D).

    Points at infinity become infinite. kornia's ``convert_points_from_homogeneous`` (0.9.0) is not
    used because it returns the numerators unchanged where ``|w| <= 1e-8``, so that (2, 4, 0)
    becomes the finite point (2, 4).
    """
    if xh.ndim < 1:
        raise InputError("points must have shape (*, D + 1), not ()")
    return xh[..., :-1] / xh[..., -1:]


def normalize(x: Tensor, K: Tensor) -> Tensor:
    """Map pixels to normalised coordinates, ``K^-1 x``.

    Distances from the origin are then tangents of the angle to the optical axis. Computed by
    kornia's ``normalize_points_with_intrinsics``, plus the skew, which kornia ignores.

    Args:
        x: (*B, N, 2) pixels, undistorted.
        K: (3, 3) or (*B, 3, 3) upper-triangular intrinsics in pixels.

    Returns:
        (*B, N, 2).

    Raises:
        InputError: K is singular or not an intrinsic matrix; x contains NaN or infinite values;
            shapes, dtypes or devices do not fit.

    Source: Hartley & Zisserman, Multiple View Geometry (2nd ed.), 6.1.
    """
    check_points(x=x)
    check_intrinsics(x, K=K)
    return kernels.normalize(x, K)


def denormalize(xn: Tensor, K: Tensor) -> Tensor:
    """Map normalised coordinates to pixels, ``K xn``; the inverse of :func:`normalize`.

    Computed by kornia's ``denormalize_points_with_intrinsics``, plus the skew, which kornia
    ignores. Shapes and errors are those of :func:`normalize`.
    """
    check_points(xn=xn)
    check_intrinsics(xn, K=K)
    x = denormalize_points_with_intrinsics(xn, K.unsqueeze(-3))
    skew = K[..., 0, 1, None] * xn[..., 1]
    return torch.stack((x[..., 0] + skew, x[..., 1]), -1)


def hartley_normalization(x: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Move the (weighted) centroid to the origin and scale the mean squared distance to 2.

    The root mean square distance becomes √2 instead of the mean distance, which conditions as well
    and is smooth. kornia's ``normalize_points`` (0.9.0) fails under ``torch.func.vmap`` because it
    writes into a new tensor. It also adds 1e-8 to the distance, so coincident points are scaled by
    1.4e8.

    Args:
        x: (*B, N, 2) points.
        weights: (*B, N) or (N,) weights, not negative.

    Returns:
        xn: (*B, N, 2) normalised points.
        T: (*B, 3, 3) with ``xn = T x``. If all points coincide, they are centred but not scaled.

    Source: Hartley, "In defense of the eight-point algorithm", PAMI 1997; Hartley & Zisserman
    4.4.4.
    """
    check_points(1, weights, x=x)
    return kernels.hartley(x, weights)


def inverse_intrinsics(K: Tensor) -> Tensor:
    """Invert (*B, 3, 3) upper-triangular intrinsics in closed form.

    kornia 0.9.0 has no inverse of 3 x 3 intrinsics; its camera classes invert a 4 x 4 matrix.

    Raises:
        InputError: K is singular or not an intrinsic matrix, its dtype is wrong, or it contains
            NaN.
    """
    check_intrinsics(K=K)
    return kernels.inverse_intrinsics(K)
