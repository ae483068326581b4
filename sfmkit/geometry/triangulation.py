"""Triangulation of points from two calibrated views, ``X2 = R X1 + t``.

The points are in the frame of camera 1. Each method minimises an objective over the point X:

========== ================================================================== ==============
method     objective                                                          cost per point
========== ================================================================== ==============
optimal    squared distances in the normalised image planes,                  closed form
           ``|xn1 - x1(X)|^2 + |xn2 - x2(X)|^2``
midpoint   squared distances in space from X to the two rays                  closed form
dlt        algebraic: the norm of ``A X`` over unit homogeneous X, A the      a null vector
           four image equations
========== ================================================================== ==============

kornia's ``triangulate_points`` (0.9.0) supports only the DLT objective. It takes 2.7 times as long
as ``dlt`` and 6.6 times as long as ``optimal`` (30,000 points, ``benchmarks/geometry.py``), and
points at infinity become NaN.

If the noise is equal in both images and the cameras have the same focal length, `optimal` is the
maximum-likelihood point. The other methods differ from it by terms of second order in the noise,
which are visible at small parallax.

Points at infinity are supported: ``homogeneous=True`` returns ``(X, Y, Z, W)`` of unit length. Its
first three components point along the ray of image 1, and W is negative for a point behind camera
1. Otherwise, the three coordinates of a point with W = 0 are infinite (never NaN). Float32 input is
computed in float64 and rounded once at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from ..errors import InputError
from ._rays import Vector, choose, components, cross, dot, image_ray, rotate, rotated_ray
from .checks import check_matrices, check_points
from .pose import check_pose

Method = Literal["optimal", "midpoint", "dlt"]


def triangulate(
    xn1: Tensor,
    xn2: Tensor,
    R: Tensor,
    t: Tensor,
    method: Method = "optimal",
    homogeneous: bool = False,
) -> Tensor:
    """Triangulate with the named method; the module describes the objectives.

    Args:
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        R, t: ``(*B, 3, 3)`` and ``(*B, 3)`` pose, ``X2 = R X1 + t``; the points are in the unit of
            t.
        method: ``optimal``, ``midpoint`` or ``dlt``.
        homogeneous: Whether to return unit ``(*B, N, 4)`` instead of ``(*B, N, 3)``.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, a value is NaN, or t is zero.
    """
    if method not in _METHODS:
        raise InputError(f"unknown triangulation method {method!r}; known: {', '.join(_METHODS)}")
    return _apply(_METHODS[method], xn1, xn2, R, t, homogeneous)


def triangulate_optimal(
    xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor, homogeneous: bool = False
) -> Tensor:
    """Triangulate with the least squared reprojection error in the normalised image planes.

    Both image points are moved by the smallest distance onto a common epipolar plane, and the
    rays, which then intersect, are intersected. After two iterations, the distance to the true
    minimum is far below the rounding of the image coordinates.

    Arguments and errors are those of :func:`triangulate`.

    Source: Lindstrom, Triangulation made easy, CVPR 2010, listing 3 (niter2).
    """
    return _apply(_optimal, xn1, xn2, R, t, homogeneous)


def triangulate_midpoint(
    xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor, homogeneous: bool = False
) -> Tensor:
    """Triangulate the midpoint of the shortest segment between the two rays.

    Arguments and errors are those of :func:`triangulate`.

    Source: Hartley and Sturm, Triangulation, CVIU 1997, section 5.3; depths as ratios of triple
    products.
    """
    return _apply(_midpoint, xn1, xn2, R, t, homogeneous)


def triangulate_dlt(
    xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor, homogeneous: bool = False
) -> Tensor:
    """Triangulate the unit X that minimises ``|A X|`` for the four linear image equations A.

    X is the singular vector of the smallest singular value, computed without an SVD. Any three of
    the four planes ``A X = 0`` intersect in one point (a row of the adjugate of A, in closed form).
    The four points agree up to noise, and X is the dominant direction of their scatter matrix.
    Repeated squaring of that 4 x 4 matrix isolates this direction to the precision of the data. The
    derivatives are finite at exact matches, where those of an SVD divide by zero.

    Arguments and errors are those of :func:`triangulate`.

    Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 12.2, equation 12.2
    (homogeneous method).
    """
    return _apply(_dlt, xn1, xn2, R, t, homogeneous)


def parallax(xn1: Tensor, xn2: Tensor, R: Tensor) -> Tensor:
    """Return the angle between the two rays of each match in radians, ``(*B, N)``.

    The angle is the arc tangent of the length of the cross product over the dot product, which is
    accurate to the rounding of the input; an arc cosine loses half of the digits below 0.01
    degrees. The derivative at parallel rays, where the angle is not differentiable, is zero. kornia
    0.9.0 has no counterpart.

    Args:
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        R: ``(*B, 3, 3)`` rotation from camera 1 to camera 2.
    """
    check_points(xn1=xn1, xn2=xn2)
    check_matrices(xn1, R=R)
    dtype = xn1.dtype
    xn1, xn2, R = xn1.double(), xn2.double(), R.double()
    p = rotated_ray(R, *xn1.unbind(-1))
    q = image_ray(*xn2.unbind(-1))
    n = cross(p, q)
    squared = dot(n, n)
    parallel = squared == 0
    length = torch.where(parallel, 1.0, squared).sqrt()
    return torch.atan2(torch.where(parallel, 0.0, length), dot(p, q)).to(dtype)


def corrected_matches(
    xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor
) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Return the nearest normalised points that satisfy the epipolar constraint of (R, t).

    kornia 0.9.0 has no counterpart.

    Args:
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        R, t: ``(*B, 3, 3)``, ``(*B, 3)`` pose, ``X2 = R X1 + t``.

    Returns:
        The components x, y ``(*B, N)`` of the points of image 1, and those of image 2.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, a value is NaN, or t is zero.
    """
    check_points(xn1=xn1, xn2=xn2)
    check_pose(R, t, like=xn1)
    return _corrected(xn1, xn2, R, t)


def _corrected(
    xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor
) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Compute :func:`corrected_matches` without checks."""
    E = torch.linalg.cross(*torch.broadcast_tensors(t[..., :, None], R), dim=-2)
    e = [[E[..., i, j, None] for j in range(3)] for i in range(3)]
    (x1, y1), (x2, y2) = xn1.unbind(-1), xn2.unbind(-1)
    # The first two coefficients of the epipolar lines: (a1, b1) in image 1 from the point of image
    # 2, and (a2, b2) in image 2 from the point of image 1.
    a1, b1 = e[0][0] * x2 + e[1][0] * y2 + e[2][0], e[0][1] * x2 + e[1][1] * y2 + e[2][1]
    a2, b2 = e[0][0] * x1 + e[0][1] * y1 + e[0][2], e[1][0] * x1 + e[1][1] * y1 + e[1][2]
    a = a2 * (e[0][0] * a1 + e[0][1] * b1) + b2 * (e[1][0] * a1 + e[1][1] * b1)
    b = 0.5 * (a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2)
    c = x2 * a2 + y2 * b2 + (e[2][0] * x1 + e[2][1] * y1 + e[2][2])
    # If both points are the epipoles (b = 0), they do not move.
    d = (b * b - a * c).clamp_min(_TINY).sqrt()
    step = c / (b + d)
    n1, m1 = a1 - step * (e[0][0] * a2 + e[1][0] * b2), b1 - step * (e[0][1] * a2 + e[1][1] * b2)
    n2, m2 = a2 - step * (e[0][0] * a1 + e[0][1] * b1), b2 - step * (e[1][0] * a1 + e[1][1] * b1)
    step = step * (2 * d / (n1 * n1 + m1 * m1 + n2 * n2 + m2 * m2).clamp_min(_TINY))
    return (x1 - step * n1, y1 - step * m1), (x2 - step * n2, y2 - step * m2)


_TINY = 1e-300


def _apply(
    method: Callable[..., list[Tensor]],
    xn1: Tensor,
    xn2: Tensor,
    R: Tensor,
    t: Tensor,
    homogeneous: bool,
) -> Tensor:
    """Run a method after checks, in float64 and in chunks that fit in the processor's cache."""
    check_points(xn1=xn1, xn2=xn2)
    check_pose(R, t, like=xn1)
    dtype = xn1.dtype
    batch = torch.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    R, t = R.double().expand(*batch, 3, 3), t.double().expand(*batch, 3)
    chunks = zip(xn1.double().split(_CHUNK, -2), xn2.double().split(_CHUNK, -2))
    parts = [_finish(method(a, b, R, t), a[..., 0], a[..., 1], homogeneous) for a, b in chunks]
    return (parts[0] if len(parts) == 1 else torch.cat(parts, -2)).to(dtype)


_CHUNK = 65_536


def _optimal(xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor) -> list[Tensor]:
    x1, x2 = _corrected(xn1, xn2, R, t)
    p, q = rotated_ray(R, *x1), image_ray(*x2)
    c = components(t)
    # The normal of the epipolar plane is computed from the ray further from the baseline. With it,
    # every depth is a ratio of volumes that is linear in each ray and regular for parallel rays.
    pt, qt = cross(p, c), cross(q, c)
    further = dot(pt, pt) * dot(q, q) > dot(qt, qt) * dot(p, p)
    n = choose(further, pt, qt)
    w = dot(cross(p, q), n)
    return _middle(x1, q, R, c, dot(qt, n), dot(pt, n), w)


def _midpoint(xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor) -> list[Tensor]:
    x1, x2 = xn1.unbind(-1), xn2.unbind(-1)
    p, q = rotated_ray(R, *x1), image_ray(*x2)
    c = components(t)
    n = cross(p, q)
    return _middle(x1, q, R, c, dot(cross(q, c), n), dot(cross(p, c), n), dot(n, n))


def _dlt(xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor) -> list[Tensor]:
    (x, y), (u, v) = xn1.unbind(-1), xn2.unbind(-1)
    # The planes of image 2 in the frame of camera 1; those of image 1 are (1, 0, -x, 0) and
    # (0, 1, -y, 0).
    P = [
        [M[..., i, j, None] for j in range(4)]
        for M in (torch.cat((R, t[..., None]), -1),)
        for i in range(3)
    ]
    c = [P[0][j] - u * P[2][j] for j in range(4)]
    d = [P[1][j] - v * P[2][j] for j in range(4)]
    # The intersections of both planes of image 1 with one plane of image 2 lie on the ray of image
    # 1.
    meet_c = _on_ray(x, y, c)
    meet_d = _on_ray(x, y, d)
    # The intersections of both planes of image 2 with one plane of image 1 are 3 x 3 minors of the
    # two with (1, 0, -x, 0) or (0, 1, -y, 0).
    m = {(i, j): c[i] * d[j] - c[j] * d[i] for i in range(4) for j in range(i + 1, 4)}
    meet_x = [x * m[1, 3], -(x * m[0, 3] + m[2, 3]), m[1, 3], x * m[0, 1] - m[1, 2]]
    meet_y = [y * m[1, 3] + m[2, 3], -y * m[0, 3], -m[0, 3], m[0, 2] + y * m[0, 1]]
    scatter = _gram([meet_c, meet_d, meet_x, meet_y])
    for _ in range(5):  # reduces the share of the second direction to its 64th power
        scale = 1 / (scatter[0][0] + scatter[1][1] + scatter[2][2] + scatter[3][3]).clamp_min(_TINY)
        scatter = _gram([[scale * s for s in row] for row in scatter])
    column, largest = scatter[0], scatter[0][0]
    for j in range(1, 4):
        larger = scatter[j][j] > largest
        column = [torch.where(larger, a, b) for a, b in zip(scatter[j], column)]
        largest = torch.where(larger, scatter[j][j], largest)
    return column


def _middle(
    x1: tuple[Tensor, ...], q: Vector, R: Tensor, c: Vector, s1: Tensor, s2: Tensor, w: Tensor
) -> list[Tensor]:
    """Return the midpoint of ``s1/w (x1, 1)`` and ``R^T (s2/w q - t)``, homogeneous."""
    back = rotate(
        R, (s2 * q[0] - w * c[0], s2 * q[1] - w * c[1], s2 * q[2] - w * c[2]), inverse=True
    )
    return [s1 * x1[0] + back[0], s1 * x1[1] + back[1], s1 + back[2], 2 * w]


def _finish(X: list[Tensor], x: Tensor, y: Tensor, homogeneous: bool) -> Tensor:
    """Convert homogeneous components to points; (x, y) is the ray of image 1."""
    if not homogeneous:
        w = X[3]
        infinite = w == 0
        scale = 1 / torch.where(infinite, 1.0, w)
        return torch.stack([torch.where(infinite, torch.inf, scale * a) for a in X[:3]], -1)
    H = torch.stack(X, -1)
    forward = X[0] * x + X[1] * y + X[2] >= 0
    H = torch.where(forward[..., None], H, -H)
    # If both rays lie on the baseline or are exactly parallel, the depth is not determined: return
    # the point at infinity on ray 1.
    ray = torch.stack((x, y, torch.ones_like(x), torch.zeros_like(x)), -1)
    H = torch.where((H == 0).all(-1, keepdim=True), ray, H)
    return H / H.norm(dim=-1, keepdim=True)


def _gram(rows: list[list[Tensor]]) -> list[list[Tensor]]:
    """Compute ``A^T A`` of a 4 x 4 matrix given as rows of components.

    For a symmetric A, this is its square.
    """
    G: list[list[Tensor]] = [[rows[0][0]] * 4 for _ in range(4)]
    for i in range(4):
        for j in range(i, 4):
            G[i][j] = G[j][i] = (
                rows[0][i] * rows[0][j]
                + rows[1][i] * rows[1][j]
                + rows[2][i] * rows[2][j]
                + rows[3][i] * rows[3][j]
            )
    return G


def _on_ray(x: Tensor, y: Tensor, plane: list[Tensor]) -> list[Tensor]:
    """Intersect the ray ``(x, y, 1)`` of image 1 with a plane, homogeneous."""
    along = plane[0] * x + plane[1] * y + plane[2]
    depth = -plane[3]
    return [x * depth, y * depth, depth.expand_as(along), along]


_METHODS = {"optimal": _optimal, "midpoint": _midpoint, "dlt": _dlt}
