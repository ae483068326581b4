"""Homographies ``x2 = H x1`` between pixels: estimation, distances, poses and planes."""

from __future__ import annotations

import torch
from kornia.geometry import homography as kornia_homography
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError
from . import kernels
from ._nullspace import detached, eigh, smallest_singular_vector
from .checks import (
    _traced,
    check_batches,
    check_determined,
    check_intrinsics,
    check_invertible,
    check_matrices,
    check_points,
    check_values,
)
from .coordinates import to_homogeneous
from .lie import hat, so3_exp, sphere_exp, tangent_basis


def homography_dlt(x1: Tensor, x2: Tensor, weights: Tensor | None = None) -> Tensor:
    """Estimate H from 4 or more matches with the normalised direct linear transform.

    The null vector is differentiated implicitly. kornia's ``find_homography_dlt`` (0.9.0) is not
    used because its gradient is wrong at exact matches (gradcheck fails) and it fails under
    ``torch.func.vmap`` (``tests/geometry/test_kornia.py`` shows both).

    Args:
        x1, x2: (*B, N, 2) pixels, N >= 4.
        weights: (*B, N) or (N,) weights of the squared algebraic residuals.

    Returns:
        (*B, 3, 3) of unit Frobenius norm and positive determinant. Float32 input is computed in
        float64.

    Raises:
        DegenerateGeometryError: There are fewer than 4 matches, or they do not determine H because
            they are collinear or repeated. In a batch, the error is raised only if this holds for
            all members; if it holds for some, their H is finite but meaningless.
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.

    Source: Hartley & Zisserman 4.1 and 4.4, algorithm 4.2.
    """
    check_points(4, weights, x1=x1, x2=x2)
    dtype = x1.dtype
    x1, x2 = x1.double(), x2.double()
    weights = None if weights is None else weights.double()
    n1, T1 = kernels.hartley(x1, weights)
    n2, T2 = kernels.hartley(x2, weights)
    h1 = to_homogeneous(n1)
    u, v = n2[..., :1], n2[..., 1:]
    zero = torch.zeros_like(h1)
    rows = torch.cat((torch.cat((h1, zero, -u * h1), -1), torch.cat((zero, h1, -v * h1), -1)), -2)
    twice = None if weights is None else torch.cat((weights, weights), -1)
    h, gap = smallest_singular_vector(rows, twice)
    check_determined(gap, dtype, "H", "they may lie on one line or be repeated")
    H = kernels.inverse_intrinsics(T2) @ h.unflatten(-1, (3, 3)) @ T1
    return _oriented(kernels.unit_norm(H)).to(dtype)


def homography_4point(x1: Tensor, x2: Tensor) -> Tensor:
    """Return H of exactly four matches in closed form, from products of 3 x 3 determinants.

    The values and derivatives are finite even if a sample of the batch repeats a point. kornia's
    ``get_perspective_transform`` (0.9.0) solves 8 x 8 systems; it then raises an error, or its
    values and derivatives are not finite. For 1000 samples, this function takes 3.7 times as long
    as kornia's (``benchmarks/geometry.py``).

    Args:
        x1, x2: (*B, 4, 2) pixels, no three of them collinear.

    Returns:
        (*B, 3, 3) of unit Frobenius norm and positive determinant; zero or singular if three points
        are collinear.

    Raises:
        InputError: There are not exactly 4 matches, shapes, dtypes or devices do not fit, or a
            value is NaN.

    Source: Hartley & Zisserman 2.3, each set of four points as a projective basis.
    """
    check_points(4, x1=x1, x2=x2)
    if x1.shape[-2] != 4:
        raise InputError(f"the four-point homography needs exactly 4 matches, not {x1.shape[-2]}")
    return _oriented(kernels.four_point(x1.double(), x2.double())).to(x1.dtype)


def _oriented(H: Tensor) -> Tensor:
    """Return H with positive determinant: the scene is on one side of both cameras."""
    return torch.where((torch.linalg.det(H) < 0)[..., None, None], -H, H)


def transfer(H: Tensor, x: Tensor) -> Tensor:
    """Return ``H x`` in pixels, (*B, N, 2); infinite where H maps a point to infinity.

    kornia's ``transform_points`` (0.9.0) is not used because it does not divide where the third
    coordinate is below 1e-8, which gives a wrong finite point.
    """
    check_points(x=x)
    check_matrices(x, H=H)
    return kernels.transfer(H, x)[0]


def squared_transfer_error(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return the squared distances of x2 from ``H x1``, (*B, N) square pixels.

    The distance is infinite where H maps x1 to infinity. Computed by kornia's
    ``oneway_transfer_error``.

    Source: Hartley & Zisserman, eq. 4.6.
    """
    return _by_kornia(kornia_homography.oneway_transfer_error, H, x1, x2)


def squared_symmetric_transfer_error(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return ``|x2 - H x1|² + |x1 - H^-1 x2|²``, (*B, N) square pixels.

    Both terms are computed by kornia's ``oneway_transfer_error``; its ``symmetric_transfer_error``
    (0.9.0) returns the largest float for a singular H instead of an error.

    Raises:
        DegenerateGeometryError: H is singular.

    Source: Hartley & Zisserman, eq. 4.7.
    """
    check_matrices(x1, H=H)
    check_invertible(H=H)
    there = squared_transfer_error(H, x1, x2)
    return there + squared_transfer_error(torch.linalg.inv(H), x2, x1)


def squared_homography_sampson_distance(H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Return the squared Sampson distances of matches to ``x2 = H x1``, (*B, N) square pixels.

    The first-order correction is distributed over the four coordinates of a match, so the distance
    is comparable with the Sampson distance to an epipolar geometry. It is infinite where it is not
    defined. Computed by kornia's ``sampson_homography_distance``.

    Source: Hartley & Zisserman 4.2.6.
    """
    return _by_kornia(kornia_homography.sampson_homography_distance, H, x1, x2)


def _by_kornia(distance, H: Tensor, x1: Tensor, x2: Tensor) -> Tensor:
    """Call a squared distance of kornia, which takes (B, 3, 3) and (B, N, 2), with any *B."""
    check_points(x1=x1, x2=x2)
    check_matrices(x1, H=H)
    batch = torch.broadcast_shapes(H.shape[:-2], x1.shape[:-2])
    H = H.expand(*batch, 3, 3).reshape(-1, 3, 3)
    if x1.ndim > 2:
        x1, x2 = (x.expand(*batch, *x.shape[-2:]).reshape(-1, *x.shape[-2:]) for x in (x1, x2))
    return distance(x1, x2, H, squared=True).reshape(*batch, x1.shape[-2])


def homography_from_pose(
    R: Tensor, t: Tensor, n: Tensor, d: Tensor | float, K1: Tensor, K2: Tensor
) -> Tensor:
    """Return ``K2 (R + t n^T / d) K1^-1``, the homography of the plane ``n · X1 = d``.

    The cameras are ``X2 = R X1 + t``. kornia 0.9.0 has no counterpart.

    Args:
        R: (*B, 3, 3) rotation.
        t, n: (*B, 3) translation, and unit normal of the plane in the frame of camera 1, pointing
            away from the camera.
        d: (*B,) distance of the plane from camera 1, in the units of t.
        K1, K2: (3, 3) or (*B, 3, 3) intrinsics.

    Raises:
        DegenerateGeometryError: d is zero: the plane passes through camera 1.
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.

    Source: Hartley & Zisserman, eq. 13.2 (whose normal points the other way).
    """
    check_matrices(R=R)
    check_matrices(R, shape=(3,), t=t, n=n)
    check_intrinsics(R, K1=K1, K2=K2)
    d = torch.as_tensor(d, dtype=R.dtype, device=R.device)
    check_values(d=d)
    check_batches(
        R=R.shape[:-2],
        t=t.shape[:-1],
        n=n.shape[:-1],
        d=d.shape,
        K1=K1.shape[:-2],
        K2=K2.shape[:-2],
    )
    if not _traced() and bool((d == 0).any()):
        raise DegenerateGeometryError("d is zero: the plane passes through camera 1")
    H = R + t[..., :, None] * (n / d[..., None])[..., None, :]
    return K2 @ H @ kernels.inverse_intrinsics(K1)


def decompose_homography(H: Tensor, K1: Tensor, K2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the poses and planes of H: ``K2^-1 H K1 ~ R + t n^T``.

    The solutions are differentiated implicitly (with least norm where solutions coincide). kornia
    0.9.0 has no counterpart, and OpenCV's decomposition (Malis & Vargas 2007) has no derivative.

    Args:
        H: (*B, 3, 3) homography of pixels, of any scale and sign.
        K1, K2: (3, 3) or (*B, 3, 3) intrinsics.

    Returns:
        R (*B, 4, 3, 3), t (*B, 4, 3) in units of the distance of the plane, and unit n (*B, 4, 3).
        The third and fourth solutions are the first and second with t and n negated. The plane is
        visible only in those solutions in which it is in front of the camera,
        ``n · (xn1, 1) > 0``. If t is parallel to n, the pairs coincide; for a pure rotation, t is 0
        and n is arbitrary.

    Raises:
        DegenerateGeometryError: H is singular.
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.

    Source: Ma, Soatto, Kosecka & Sastry, An Invitation to 3-D Vision, theorem 5.19.
    """
    check_matrices(H=H)
    check_intrinsics(H, K1=K1, K2=K2)
    check_invertible(H=H)
    A = kernels.inverse_intrinsics(K2.double()) @ H.double() @ K1.double()
    A = A / A.abs().amax((-2, -1), keepdim=True)  # the squares of large values overflow
    check_invertible(H=A)
    scale0, R0, t0, n0, inverse = detached(_decompose, A)
    basis = tangent_basis(n0)
    step = torch.zeros_like(inverse[..., 0])
    # Two steps of Newton's method with a constant derivative: the first step gives correct first
    # derivatives, the second step correct second derivatives.
    for _ in range(2):
        scale, R, t, n = _moved(scale0, R0, t0, n0, basis, step)
        residual = (
            scale[..., None, None] * A[..., None, :, :] - R - t[..., :, None] * n[..., None, :]
        )
        step = step + (inverse @ residual.flatten(-2)[..., None]).squeeze(-1)
    _, R, t, n = _moved(scale0, R0, t0, n0, basis, step)
    return R.to(H.dtype), t.to(H.dtype), n.to(H.dtype)


def _moved(
    scale: Tensor, R: Tensor, t: Tensor, n: Tensor, basis: Tensor, step: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the solution after a step in (ω, t, rotation of n, log scale)."""
    turn = (basis @ step[..., 6:8, None]).squeeze(-1)
    R = so3_exp(step[..., :3]) @ R
    return scale * step[..., 8].exp(), R, t + step[..., 3:6], sphere_exp(n, turn)


def _decompose(A: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Solve ``scale A = R + t n^T`` for scale, R, t and n.

    The last result is the pseudo-inverse of the derivative of the right side minus the left side
    with respect to (ω, t, rotation of n, log scale).
    """
    values, V = eigh(A.mT @ A)
    middle = values[..., 1]
    scale = (
        torch.where(torch.linalg.det(A) < 0, -1.0, 1.0)
        / middle.clamp(min=torch.finfo(A.dtype).tiny).sqrt()
    )
    A = scale[..., None, None] * A
    l3, l1 = values[..., 0] / middle, values[..., 2] / middle
    v3, v2, v1 = V.unbind(-1)
    p, q = (1 - l3).clamp(min=0).sqrt(), (l1 - 1).clamp(min=0).sqrt()
    p = torch.where(p + q > 0, p, 1.0)  # a pure rotation: the normal is arbitrary
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
    if not _traced() and not bool(J.isfinite().all()):
        raise DegenerateGeometryError("H is singular up to rounding")
    return scale[..., None].expand(t4.shape[:-1]), R4, t4, n4, torch.linalg.pinv(J, rtol=1e-7)
