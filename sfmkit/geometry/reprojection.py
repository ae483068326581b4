"""Projection of points in space to pixels, and reprojection errors."""

from __future__ import annotations

import torch
from torch import Tensor

from ..errors import InputError
from .checks import check_batches, check_intrinsics, check_matrices, check_points
from .distortion import distort


def project(
    X: Tensor,
    K: Tensor,
    R: Tensor | None = None,
    t: Tensor | None = None,
    distortion: Tensor | None = None,
) -> Tensor:
    """Project points in space to the pixels ``K distort(pi(R X + t))``, ``(*B, N, 2)``.

    Points behind the camera are projected too (through the centre); points in its focal plane
    become infinite. kornia's ``project_points`` (0.9.0) is not used because it ignores the skew of
    K, does not accept homogeneous points, and does not divide where the depth is below 1e-8.

    Args:
        X: ``(*B, N, 3)`` points, or ``(*B, N, 4)`` homogeneous points, which may lie at infinity.
        K: ``(*B, 3, 3)`` intrinsics in pixels.
        R, t: ``(*B, 3, 3)``, ``(*B, 3)`` pose of the camera; by default, X is in the frame of the
            camera.
        distortion: ``(*B, 5)`` coefficients k1, k2, p1, p2, k3.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.

    Source: Hartley and Zisserman, 2nd ed., equations 6.7 and 7.4 (pinhole); distortion as in
    :func:`distort`.
    """
    if X.ndim < 2 or X.shape[-1] not in (3, 4):
        raise InputError(f"X must have shape (*B, N, 3) or (*B, N, 4), not {tuple(X.shape)}")
    check_points(X=X, dim=X.shape[-1])
    check_intrinsics(X, K=K)
    batches = {"X": X.shape[:-2], "K": K.shape[:-2]}
    for name, a, dims in (("R", R, 2), ("t", t, 1), ("distortion", distortion, 1)):
        if a is not None:
            batches[name] = a.shape[:-dims]
    check_batches(**batches)
    Y = X[..., :3]
    if R is not None:
        check_matrices(X, R=R)
        Y = Y @ R.mT
    if t is not None:
        check_matrices(X, shape=(3,), t=t)
        Y = Y + (t[..., None, :] if X.shape[-1] == 3 else t[..., None, :] * X[..., 3:])
    xn = Y[..., :2] / Y[..., 2:]
    if distortion is not None:
        xn = distort(xn, distortion)
    return xn @ K[..., :2, :2].mT + K[..., None, :2, 2]


def reprojection_residuals(
    X: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    R: Tensor,
    t: Tensor,
    d1: Tensor | None = None,
    d2: Tensor | None = None,
) -> Tensor:
    """Return projected minus observed pixels, ``(*B, N, 4)``.

    The order is x, y in image 1, x, y in image 2. kornia 0.9.0 has no counterpart.

    Args:
        X: ``(*B, N, 3)`` points in the frame of camera 1, or homogeneous ``(*B, N, 4)``.
        x1, x2: ``(*B, N, 2)`` pixels.
        K1, K2, R, t: Intrinsics and pose, ``X2 = R X1 + t``.
        d1, d2: ``(*B, 5)`` distortion of each camera; None for undistorted pixels.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.
    """
    check_points(x1=x1, x2=x2)
    p1, p2 = project(X, K1, distortion=d1), project(X, K2, R, t, d2)
    check_batches(X=X.shape[:-1], x1=x1.shape[:-1])
    check_batches(projected1=p1.shape, projected2=p2.shape, x1=x1.shape)
    return torch.cat(torch.broadcast_tensors(p1 - x1, p2 - x2), -1)


def reprojection_error(
    X: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    R: Tensor,
    t: Tensor,
    d1: Tensor | None = None,
    d2: Tensor | None = None,
) -> Tensor:
    """Return the root mean square reprojection error over the two images, ``(*B, N)`` pixels.

    Arguments and errors are those of :func:`reprojection_residuals`. The derivative at zero error
    is zero.
    """
    r = reprojection_residuals(X, x1, x2, K1, K2, R, t, d1, d2)
    square = (r * r).sum(-1) / 2
    exact = square == 0
    return torch.where(exact, 0.0, torch.where(exact, 1.0, square).sqrt())
