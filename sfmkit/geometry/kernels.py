"""Unchecked kernels: the inner loops of the geometry and of the robust search.

These functions do not check shapes, dtypes, values or degeneracy; NaN input gives NaN output. They
are meant for code that calls them many times on input that was checked once. The public functions
of the other modules check their input and then call these.
"""

from __future__ import annotations

import torch
from kornia.geometry.conversions import (
    convert_points_to_homogeneous,
    normalize_points_with_intrinsics,
)
from kornia.geometry.epipolar import find_essential, find_fundamental
from torch import Tensor

Pair = tuple[Tensor, Tensor]

__all__ = [
    "cofactors",
    "epipolar_rows",
    "essential_candidates",
    "four_point",
    "fundamental_candidates",
    "hartley",
    "inverse_intrinsics",
    "normalize",
    "one_pose",
    "residual_and_lines",
    "signed_sampson",
    "solutions_first",
    "squared_homography_sampson",
    "transfer",
    "unit_norm",
]


def inverse_intrinsics(K: Tensor) -> Tensor:
    """Invert (*B, 3, 3) upper-triangular intrinsics in closed form."""
    fx, s, cx = K[..., 0, 0], K[..., 0, 1], K[..., 0, 2]
    fy, cy = K[..., 1, 1], K[..., 1, 2]
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    rows = (
        *(1 / fx, -s / (fx * fy), (s * cy / fy - cx) / fx),
        *(zero, 1 / fy, -cy / fy),
        *(zero, zero, one),
    )
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def normalize(x: Tensor, K: Tensor) -> Tensor:
    """Map pixels (*B, N, 2) to normalised coordinates, ``K^-1 x``."""
    # kornia ignores the skew K[0, 1], whose contribution to u is proportional to v.
    xn = normalize_points_with_intrinsics(x, K.unsqueeze(-3))
    skew = (K[..., 0, 1] / K[..., 0, 0])[..., None]
    return torch.stack((xn[..., 0] - skew * xn[..., 1], xn[..., 1]), -1)


def hartley(x: Tensor, weights: Tensor | None = None) -> Pair:
    """Normalise points (*B, N, 2) to centroid 0 and mean squared length 2.

    Returns the points and T (*B, 3, 3); see
    :func:`sfmkit.geometry.coordinates.hartley_normalization`.
    """
    if weights is None:
        centre = x.mean(-2)
        moved = x - centre[..., None, :]
        variance = moved.square().sum((-2, -1)) / x.shape[-2]
    else:
        total = weights.sum(-1, keepdim=True)
        w = weights / torch.where(total > 0, total, 1.0)
        centre = (w[..., None] * x).sum(-2)
        moved = x - centre[..., None, :]
        variance = (w[..., None] * moved.square()).sum((-2, -1))
    spread = variance > 0
    scale = torch.where(spread, 2 / torch.where(spread, variance, 1.0), 1.0).sqrt()
    zero, one = torch.zeros_like(scale), torch.ones_like(scale)
    rows = (
        *(scale, zero, -scale * centre[..., 0]),
        *(zero, scale, -scale * centre[..., 1]),
        *(zero, zero, one),
    )
    return moved * scale[..., None, None], torch.stack(rows, -1).unflatten(-1, (3, 3))


def unit_norm(M: Tensor) -> Tensor:
    """Divide (*B, 3, 3) matrices by their Frobenius norms; a zero matrix becomes NaN."""
    return M / M.flatten(-2).norm(dim=-1)[..., None, None]


def cofactors(A: Tensor) -> Tensor:
    """Return the (*B, 3, 3) matrix of cofactors: the cross products of the rows."""
    a, b, c = A.unbind(-2)
    return torch.stack([torch.linalg.cross(p, q, dim=-1) for p, q in ((b, c), (c, a), (a, b))], -2)


def epipolar_rows(x1: Tensor, x2: Tensor) -> Tensor:
    """Return (*B, N, 9) rows with ``rows @ F.flatten() = x2^T F x1``."""
    (a, b), (u, v) = x1.unbind(-1), x2.unbind(-1)
    # One contiguous vector per column is five times as fast as products of (N, 3) tensors.
    columns = (u * a, u * b, u, v * a, v * b, v, a, b, torch.ones_like(a))
    return torch.stack(columns, -2).mT


def residual_and_lines(F: Tensor, x1: Tensor, x2: Tensor) -> tuple[Tensor, Pair, Pair]:
    """Return ``x2^T F x1`` and the first two coordinates of ``F x1`` and ``F^T x2``.

    All results have the shape (*B, N).
    """
    f = F.unsqueeze(-1)
    u1, v1 = x1[..., 0], x1[..., 1]
    u2, v2 = x2[..., 0], x2[..., 1]
    a, b, c = (f[..., i, 0, :] * u1 + f[..., i, 1, :] * v1 + f[..., i, 2, :] for i in range(3))
    d, e = (f[..., 0, j, :] * u2 + f[..., 1, j, :] * v2 + f[..., 2, j, :] for j in range(2))
    return u2 * a + v2 * b + c, (a, b), (d, e)


def signed_sampson(F: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return signed Sampson distances (*B, N); zero where both points are the epipoles."""
    r, (a, b), (c, d) = residual_and_lines(F, x1, x2)
    square = a * a + b * b + c * c + d * d
    return r / torch.where(square > 0, square, 1.0).sqrt()


def transfer(H: Tensor, x: Tensor) -> Pair:
    """Return ``H x`` (*B, N, 2) and the third homogeneous coordinate (*B, N)."""
    h = H.unsqueeze(-1)
    u, v = x[..., 0], x[..., 1]
    a, b, w = (h[..., i, 0, :] * u + h[..., i, 1, :] * v + h[..., i, 2, :] for i in range(3))
    return torch.stack((a / w, b / w), -1), w


def squared_homography_sampson(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return squared first-order distances (*B, N) of matches to ``x2 = H x1``.

    With ``r = x2 - H x1`` and the derivative A of ``H x1``, the squared distance is
    ``r^T (I + A A^T)^-1 r``. It is computed as a ratio of sums of squares, so no digits cancel, in
    float32 either. It agrees with
    :func:`sfmkit.geometry.homography.squared_homography_sampson_distance` to second order in r.
    """
    y, w = transfer(H, x1)
    h = H.unsqueeze(-1)
    a, b, c, d = (
        (h[..., i, j, :] - y[..., i] * h[..., 2, j, :]) / w for i in range(2) for j in range(2)
    )
    r, s = x2[..., 0] - y[..., 0], x2[..., 1] - y[..., 1]
    square = r * r + s * s + (c * r - a * s) ** 2 + (d * r - b * s) ** 2
    square = square / (1 + a * a + b * b + c * c + d * d + (a * d - b * c) ** 2)
    return torch.where(torch.isfinite(square), square, torch.inf)


def four_point(x1: Tensor, x2: Tensor) -> Tensor:
    """Return homographies (*B, 3, 3) of four matches (*B, 4, 2).

    They have unit norm and arbitrary sign. The result is zero where all products of the closed form
    vanish (repeated points).
    """
    (n1, T1), (n2, T2) = hartley(x1), hartley(x2)
    (s1, c1), (s2, _) = _basis(n1), _basis(n2)
    a, b, c = s1.unbind(-1)
    scale = s2 * torch.stack((b * c, a * c, a * b), -1)
    H = (scale[..., None] * convert_points_to_homogeneous(n2[..., :3, :])).mT @ c1
    H = inverse_intrinsics(T2) @ H @ T1
    size = H.flatten(-2).norm(dim=-1)[..., None, None]
    return torch.where(size > 0, H / torch.where(size > 0, size, 1.0), 0.0)


def _basis(x: Tensor) -> Pair:
    """Express the fourth point of (*B, 4, 2) in the projective basis of the first three.

    Returns s (*B, 3) with ``p4 ~ Σ s_i p_i``, and the rows ``p2 x p3``, ``p3 x p1``, ``p1 x p2``.
    """
    p1, p2, p3, p4 = convert_points_to_homogeneous(x).unbind(-2)
    cross = torch.stack(
        [torch.linalg.cross(a, b, dim=-1) for a, b in ((p2, p3), (p3, p1), (p1, p2))], -2
    )
    return (cross @ p4[..., None]).squeeze(-1), cross


def essential_candidates(xn1: Tensor, xn2: Tensor) -> Pair:
    """Solve five normalised matches (B, 5, 2) for E with kornia's five-point solver.

    Returns:
        E: (B, 10, 3, 3) of Frobenius norm √2, zero where there is no solution; not polished.
        valid: (B, 10) bool, whether there is a solution.
    """
    E = find_essential(xn1, xn2)
    valid = E.isfinite().flatten(-2).all(-1)
    return torch.where(valid[..., None, None], E * 2**0.5, 0.0), valid


def fundamental_candidates(x1: Tensor, x2: Tensor) -> Pair:
    """Solve seven matches (B, 7, 2) in pixels for F with kornia's seven-point solver.

    Returns:
        F: (B, 3, 3, 3) of unit Frobenius norm, zero where there is no solution; not polished.
        valid: (B, 3) bool, whether there is a solution.
    """
    F = find_fundamental(x1, x2, method="7POINT")
    size = F.flatten(-2).norm(dim=-1)
    valid = size.isfinite() & (size > 0)
    size = torch.where(valid, size, 1.0)[..., None, None]
    return torch.where(valid[..., None, None], F / size, 0.0), valid


def solutions_first(M: Tensor, valid: Tensor) -> Pair:
    """Move the valid solutions of (B, S, 3, 3) to the first slots, and set the others to zero."""
    order = (~valid).to(torch.uint8).argsort(dim=-1, stable=True)
    M = torch.where(valid[..., None, None], M, 0.0)
    return torch.take_along_dim(M, order[..., None, None], 1), valid.gather(1, order)


def one_pose(E: Tensor) -> Pair:
    """Return one of the poses (R, unit t) of an E of Frobenius norm √2, in closed form.

    R is a rotation matrix even if E lies slightly off the essential manifold; the pose is then that
    of a nearby essential matrix.
    """
    a, b, c = E.unbind(-1)
    crosses = torch.stack(
        [torch.linalg.cross(p, q, dim=-1) for p, q in ((a, b), (b, c), (c, a))], -2
    )
    longest = crosses.square().sum(-1).argmax(-1)
    t = torch.nn.functional.normalize(
        torch.take_along_dim(crosses, longest[..., None, None], -2).squeeze(-2), dim=-1
    )
    R = cofactors(E) - torch.linalg.cross(t[..., :, None].expand_as(E), E, dim=-2)
    for _ in range(2):  # Newton-Schulz: the error is squared each time
        R = 1.5 * R - 0.5 * R @ R.mT @ R
    return R, t
