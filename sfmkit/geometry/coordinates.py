"""Homogeneous coordinates, pixels and normalised coordinates, and Hartley's normalisation."""

from __future__ import annotations

import torch
from torch import Tensor

from ._checks import check_intrinsics, check_kind, check_points


def to_homogeneous(x: Tensor) -> Tensor:
    """Append a 1: (*, D) -> (*, D + 1)."""
    return torch.nn.functional.pad(x, (0, 1), value=1.0)


def from_homogeneous(xh: Tensor) -> Tensor:
    """Divide by the last coordinate: (*, D + 1) -> (*, D). Points at infinity come out infinite."""
    return xh[..., :-1] / xh[..., -1:]


def normalize(x: Tensor, K: Tensor) -> Tensor:
    """Pixels to normalised coordinates: ``K^-1 x``, lengths then being tangents of angles.

    Args:
        x: (*B, N, 2) pixels, undistorted.
        K: (3, 3) or (*B, 3, 3) upper-triangular intrinsics in pixels.

    Returns:
        (*B, N, 2).

    Raises:
        InputError: K is singular or no intrinsic matrix; shapes, dtypes or devices do not fit.

    Source: Hartley & Zisserman, Multiple View Geometry (2nd ed.), 6.1.
    """
    check_kind(x=x)
    check_intrinsics(x, K=K)
    return _normalize(x, K)


def _normalize(x: Tensor, K: Tensor) -> Tensor:
    v = (x[..., 1] - K[..., 1, 2, None]) / K[..., 1, 1, None]
    u = (x[..., 0] - K[..., 0, 2, None] - K[..., 0, 1, None] * v) / K[..., 0, 0, None]
    return torch.stack((u, v), -1)


def denormalize(xn: Tensor, K: Tensor) -> Tensor:
    """Normalised coordinates to pixels: ``K xn``; the inverse of :func:`normalize`, same shapes and
    errors."""
    check_kind(xn=xn)
    check_intrinsics(xn, K=K)
    u, v = xn[..., 0], xn[..., 1]
    return torch.stack(
        (
            K[..., 0, 0, None] * u + K[..., 0, 1, None] * v + K[..., 0, 2, None],
            K[..., 1, 1, None] * v + K[..., 1, 2, None],
        ),
        -1,
    )


def hartley_normalization(x: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Similarity that moves the (weighted) centroid to the origin and the mean squared distance
    from it to 2.

    The root mean square distance, not the mean distance, is brought to √2: it conditions as well
    and is smooth.

    Args:
        x: (*B, N, 2).
        weights: (*B, N) or (N,), not negative.

    Returns:
        xn: (*B, N, 2) the moved points.
        T: (*B, 3, 3) with ``xn = T x``. Points that all coincide are centred and keep their scale.

    Source: Hartley, "In defense of the eight-point algorithm", PAMI 1997; Hartley & Zisserman
    4.4.4.
    """
    check_points(1, weights, x=x)
    return _hartley(x, weights)


def _hartley(x: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    if weights is None:
        centre = x.mean(-2)
        moved = x - centre[..., None, :]
        variance = (moved**2).sum(-1).mean(-1)
    else:
        total = weights.sum(-1, keepdim=True)
        w = weights / torch.where(total > 0, total, 1.0)
        centre = (w[..., None] * x).sum(-2)
        moved = x - centre[..., None, :]
        variance = (w * (moved**2).sum(-1)).sum(-1)
    spread = variance > 0
    scale = torch.where(spread, 2 / torch.where(spread, variance, 1.0), 1.0).sqrt()
    zero, one = torch.zeros_like(scale), torch.ones_like(scale)
    T = torch.stack(
        (
            scale,
            zero,
            -scale * centre[..., 0],
            zero,
            scale,
            -scale * centre[..., 1],
            zero,
            zero,
            one,
        ),
        -1,
    ).unflatten(-1, (3, 3))
    return moved * scale[..., None, None], T


def inverse_intrinsics(K: Tensor) -> Tensor:
    """``K^-1`` of (*B, 3, 3) upper-triangular intrinsics, in closed form."""
    fx, s, cx = K[..., 0, 0], K[..., 0, 1], K[..., 0, 2]
    fy, cy = K[..., 1, 1], K[..., 1, 2]
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    rows = (
        1 / fx,
        -s / (fx * fy),
        (s * cy / fy - cx) / fx,
        zero,
        1 / fy,
        -cy / fy,
        zero,
        zero,
        one,
    )
    return torch.stack(rows, -1).unflatten(-1, (3, 3))
