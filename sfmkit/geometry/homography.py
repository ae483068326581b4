"""Homographies ``x2 = H x1`` between pixels: estimation, distances, and the poses and planes behind
them."""

from __future__ import annotations

import torch
from torch import Tensor

from ._checks import check_determined, check_intrinsics, check_kind, check_matrices, check_points
from ._nullspace import detached, smallest_singular_vector
from .coordinates import _hartley, inverse_intrinsics, to_homogeneous
from .fundamental import unit_norm
from .lie import hat, so3_exp, sphere_exp, tangent_basis


def homography_dlt(x1: Tensor, x2: Tensor, weights: Tensor | None = None) -> Tensor:
    """H from 4 or more matches: the normalised direct linear transform.

    Args:
        x1, x2: (*B, N, 2) pixels, N >= 4.
        weights: (*B, N) or (N,) of the squared algebraic residuals.

    Returns:
        (*B, 3, 3) of unit Frobenius norm, with positive determinant. Float32 is computed in
        float64.

    Raises:
        DegenerateGeometryError: fewer than 4 matches, or matches that leave H open: collinear or
            repeated (in a batch: when all its members are so; where only some are, their H is
            finite but means nothing).
        InputError: shapes, dtypes, devices, NaN.

    Source: Hartley & Zisserman 4.1 and 4.4, algorithm 4.2. The null vector is differentiated
    implicitly, unlike that of kornia's ``find_homography_dlt``, whose SVD's derivative divides by
    differences of all singular values.
    """
    check_points(4, weights, x1=x1, x2=x2)
    dtype = x1.dtype
    x1, x2 = x1.double(), x2.double()
    weights = None if weights is None else weights.double()
    n1, T1 = _hartley(x1, weights)
    n2, T2 = _hartley(x2, weights)
    h1 = to_homogeneous(n1)
    u, v = n2[..., :1], n2[..., 1:]
    zero = torch.zeros_like(h1)
    rows = torch.cat((torch.cat((h1, zero, -u * h1), -1), torch.cat((zero, h1, -v * h1), -1)), -2)
    h, gap = smallest_singular_vector(
        rows, None if weights is None else torch.cat((weights, weights), -1)
    )
    check_determined(gap, dtype, "H", "they may lie on one line or repeat one another")
    H = inverse_intrinsics(T2) @ h.unflatten(-1, (3, 3)) @ T1
    return _oriented(H).to(dtype)


def homography_4point(x1: Tensor, x2: Tensor) -> Tensor:
    """H of exactly four matches, in closed form: products of 3 x 3 determinants, no decomposition
    and no division.

    Args:
        x1, x2: (*B, 4, 2) pixels, no three on a line.

    Returns:
        (*B, 3, 3) of unit Frobenius norm and positive determinant; zero or singular when three
        points lie on a line.

    Source: Hartley & Zisserman 2.3, each set of four points as a projective basis. Chosen for
    what it does to bad samples, not for speed: with one repeated point in a batch, values and
    derivatives of ``kornia.geometry.get_perspective_transform`` (8 x 8 systems) are not finite,
    here they are. 1000 samples take 1.0 ms, kornia's 0.3 ms.
    """
    check_points(4, x1=x1, x2=x2)
    if x1.shape[-2] != 4:
        check_points(x1=x1[..., :4, :], x2=x2)  # says which shapes differ
    dtype = x1.dtype
    H = _four_point(x1.double(), x2.double())
    return torch.where((torch.linalg.det(H) < 0)[..., None, None], -H, H).to(dtype)


def _four_point(x1: Tensor, x2: Tensor) -> Tensor:
    (n1, T1), (n2, T2) = _hartley(x1), _hartley(x2)
    (s1, c1), (s2, _) = _basis(n1), _basis(n2)
    a, b, c = s1.unbind(-1)
    scale = s2 * torch.stack((b * c, a * c, a * b), -1)
    H = (scale[..., None] * to_homogeneous(n2[..., :3, :])).mT @ c1
    H = inverse_intrinsics(T2) @ H @ T1
    size = H.flatten(-2).norm(dim=-1)[..., None, None]
    return torch.where(size > 0, H / torch.where(size > 0, size, 1.0), 0.0)


def _basis(x: Tensor) -> tuple[Tensor, Tensor]:
    """Of four points p: the scales s with ``p4 ~ Σ s_i p_i`` (*B, 3), and the rows
    ``p2 x p3, p3 x p1, p1 x p2``."""
    p = to_homogeneous(x)
    p1, p2, p3, p4 = p.unbind(-2)
    cross = torch.stack(
        [torch.linalg.cross(a, b, dim=-1) for a, b in ((p2, p3), (p3, p1), (p1, p2))], -2
    )
    return (cross @ p4[..., None]).squeeze(-1), cross


def _oriented(H: Tensor) -> Tensor:
    """Unit Frobenius norm and positive determinant: the scene lies on one side of both cameras."""
    sign = torch.where(torch.linalg.det(H) < 0, -1.0, 1.0).detach()
    return unit_norm(H) * sign[..., None, None]


def transfer(H: Tensor, x: Tensor) -> Tensor:
    """``H x`` in pixels, (*B, N, 2); infinite where H sends a point to infinity."""
    check_points(x=x)
    check_matrices(x, H=H)
    return _transfer(H, x)[0]


def _transfer(H: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """``H x`` (*B, N, 2), and the third homogeneous coordinate (*B, N)."""
    h = H.unsqueeze(-1)
    u, v = x[..., 0], x[..., 1]
    a, b, w = (h[..., i, 0, :] * u + h[..., i, 1, :] * v + h[..., i, 2, :] for i in range(3))
    return torch.stack((a / w, b / w), -1), w


def transfer_error(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N) squared distance of x2 from ``H x1``, square pixels. Source: Hartley & Zisserman, eq.
    4.6."""
    check_points(x1=x1, x2=x2)
    return ((x2 - transfer(H, x1)) ** 2).sum(-1)


def symmetric_transfer_error(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N) squared distances ``|x2 - H x1|² + |x1 - H^-1 x2|²``, square pixels. Source: ibid.,
    eq. 4.7."""
    return transfer_error(H, x1, x2) + transfer_error(torch.linalg.inv(H), x2, x1)


def homography_sampson(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """(*B, N) squared first-order distance of a match to ``x2 = H x1``, shared by its four
    coordinates, square pixels.

    With ``r = x2 - H x1`` and A the derivative of ``H x1`` it is ``r^T (I + A A^T)^-1 r``:
    comparable with the Sampson distance to an epipolar geometry. Infinite where H sends x1 to
    infinity.

    Source: Hartley & Zisserman 4.2.6.
    """
    check_points(x1=x1, x2=x2)
    check_matrices(x1, H=H)
    return _homography_sampson(H, x1, x2)


def _homography_sampson(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    y, w = _transfer(H, x1)
    h = H.unsqueeze(-1)
    a, b, c, d = (
        (h[..., i, j, :] - y[..., i] * h[..., 2, j, :]) / w for i in range(2) for j in range(2)
    )
    r, s = x2[..., 0] - y[..., 0], x2[..., 1] - y[..., 1]
    # r^T (I + A A^T)^-1 r as a ratio of sums of squares: nothing cancels.
    square = r * r + s * s + (c * r - a * s) ** 2 + (d * r - b * s) ** 2
    square = square / (1 + a * a + b * b + c * c + d * d + (a * d - b * c) ** 2)
    return torch.where(torch.isfinite(square), square, torch.inf)


def homography_from_pose(
    R: Tensor, t: Tensor, n: Tensor, d: Tensor | float, K1: Tensor, K2: Tensor
) -> Tensor:
    """``K2 (R + t n^T / d) K1^-1``: what the plane ``n · X1 = d`` does between the cameras
    ``X2 = R X1 + t``.

    Args:
        R: (*B, 3, 3).
        t, n: (*B, 3); n is the unit normal of the plane in camera 1, pointing away from it.
        d: (*B,) distance of the plane, in the units of t.

    Source: Hartley & Zisserman, eq. 13.2 (whose normal points the other way).
    """
    check_kind(R=R, t=t, n=n)
    check_intrinsics(R, K1=K1, K2=K2)
    d = torch.as_tensor(d, dtype=R.dtype, device=R.device)
    return K2 @ (R + t[..., :, None] * (n / d[..., None])[..., None, :]) @ inverse_intrinsics(K1)


def decompose_homography(H: Tensor, K1: Tensor, K2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The poses and planes that give H: ``K2^-1 H K1 ~ R + t n^T``.

    Args:
        H: (*B, 3, 3) pixels, any scale and sign. K1, K2: (3, 3) or (*B, 3, 3).

    Returns:
        R (*B, 4, 3, 3), t (*B, 4, 3), n (*B, 4, 3): t in units of the plane's distance, n unit. The
        third and fourth solutions are the first and second with t and n negated; only those whose
        plane is in front, ``n · (xn1, 1) > 0``, can have been seen. When t is parallel to n the
        pairs fall together; under pure rotation t is 0 and n arbitrary.

    Source: Ma, Soatto, Kosecka & Sastry, An Invitation to 3-D Vision, theorem 5.19. OpenCV's
    decomposition (Malis & Vargas 2007) has no derivative; this is differentiated implicitly (least
    norm where solutions fall together).
    """
    check_matrices(H=H)
    check_intrinsics(H, K1=K1, K2=K2)
    A = (inverse_intrinsics(K2) @ H @ K1).double()
    scale, R, t, n, inverse = detached(_decompose, A)
    target = scale[..., None, None] * A[..., None, :, :]
    residual = target - (R + t[..., :, None] * n[..., None, :])
    step = (inverse @ residual.flatten(-2)[..., None]).squeeze(-1)
    R = so3_exp(step[..., :3]) @ R
    t = t + step[..., 3:6]
    n = sphere_exp(n, (tangent_basis(n) @ step[..., 6:8, None]).squeeze(-1))
    return R.to(H.dtype), t.to(H.dtype), n.to(H.dtype)


def _decompose(A: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """``scale A = R + t n^T``: scale, R, t, n, and the pseudo-inverse of the derivative in (ω, t,
    turn of n, log scale)."""
    values, V = torch.linalg.eigh(A.mT @ A)
    middle = values[..., 1]
    scale = (
        torch.where(torch.linalg.det(A) < 0, -1.0, 1.0)
        / middle.clamp(min=torch.finfo(A.dtype).tiny).sqrt()
    )
    A = scale[..., None, None] * A
    l3, l1 = values[..., 0] / middle, values[..., 2] / middle
    v3, v2, v1 = V.unbind(-1)
    p, q = (1 - l3).clamp(min=0).sqrt(), (l1 - 1).clamp(min=0).sqrt()
    p = torch.where(p + q > 0, p, 1.0)  # a pure rotation: any normal will do
    length = torch.hypot(p, q)
    R, t, n = [], [], []
    for sign in (1, -1):
        u = (p[..., None] * v1 + sign * q[..., None] * v3) / length[..., None]
        normal = torch.linalg.cross(v2, u, dim=-1)
        U = torch.stack((v2, u, normal), -1)
        a, b = (A @ v2[..., None]).squeeze(-1), (A @ u[..., None]).squeeze(-1)
        W = torch.stack((a, b, torch.linalg.cross(a, b, dim=-1)), -1)
        R.append(W @ U.mT)
        t.append(((A - R[-1]) @ normal[..., None]).squeeze(-1))
        n.append(normal)
    R4 = torch.stack((R[0], R[1], R[0], R[1]), -3)
    t4 = torch.stack((t[0], t[1], -t[0], -t[1]), -2)
    n4 = torch.stack((n[0], n[1], -n[0], -n[1]), -2)
    eye = torch.eye(3, dtype=A.dtype, device=A.device)
    rotation = hat(eye) @ R4[..., None, :, :]
    translation = eye[:, :, None] * n4[..., None, None, :]
    turn = t4[..., None, :, None] * tangent_basis(n4).mT[..., :, None, :]
    size = -A[..., None, None, :, :].expand(*turn.shape[:-3], 1, 3, 3)
    J = torch.cat((rotation, translation, turn, size), -3).flatten(-2).mT
    return scale[..., None].expand(t4.shape[:-1]), R4, t4, n4, torch.linalg.pinv(J, rtol=1e-7)
