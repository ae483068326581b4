"""Covariance of a pose with spatially correlated errors and uncertain cameras.

:func:`sfmkit.geometry.uncertainty.covariance` assumes that the errors of the matches are
independent. Detectors have systematic errors where a surface is foreshortened or blurred, so the
errors of neighbouring matches are correlated, and that covariance is several times too small on
photographs. This module estimates two further parts, to first order and without refitting:

- blocks: the delete-one-block jackknife (CR3) over tiles of image 1, which needs no model of the
  correlation within a tile;
- cameras: the covariance of the intrinsics, propagated to the minimum of the robust Sampson cost.

Sources: Bell and McCaffrey, Bias reduction in standard errors for linear regression with
multi-stage samples, Survey Methodology 2002 (CR3); Hartley and Zisserman, 2nd ed., section 5.2.6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError
from .checks import (
    _traced,
    check_intrinsics,
    check_kind,
    check_matrices,
    check_points,
    check_values,
)
from .coordinates import inverse_intrinsics, normalize, to_homogeneous
from .focal_refinement import FreeFocal, focal_unknowns
from .lie import hat, so3_exp, sphere_exp, tangent_basis
from .loss_kernels import Loss, loss_terms
from .pose import check_pose
from .triangulation import triangulate_optimal

_STEP = 1e-5  # radians, shares of the focal length or pixels: the cube root of float64's rounding
INTRINSICS = ("relative focal length", "principal point x", "principal point y", "k1")


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """A robust Sampson cost linearised at its minimum.

    Attributes:
        score: ``(N, P)`` gradient of the cost of each match, square pixels. P = 5 for the pose
            ``(omega, b)`` (see :class:`~sfmkit.geometry.uncertainty.Uncertainty`); P = 7 or 9 with
            the logarithms of estimated focal lengths and k1 of their cameras.
        hessian: ``(N, P, P)`` second derivative of the cost of each match; where cameras are
            estimated, with the mean second derivative of the loss.
        by_intrinsics: ``(P, 8)`` derivative of the minimum with respect to the intrinsics of camera
            1 and then of camera 2, each in the order of :data:`INTRINSICS`; zero for those that are
            estimated.
    """

    score: Tensor
    hessian: Tensor
    by_intrinsics: Tensor


def linearise_pose(
    R: Tensor,
    t: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    *,
    loss: Loss = "cauchy",
    loss_scale: float = 0.5,
    focal: FreeFocal | None = None,
) -> Sensitivity:
    """Linearise the robust Sampson cost of a pose, and of cameras, at its minimum.

    Args:
        R, t: ``(3, 3)`` and ``(3,)`` pose, ``X2 = R X1 + t``.
        x1, x2: ``(N, 2)`` undistorted pixels of the inliers.
        K1, K2: ``(3, 3)`` intrinsics.
        loss, loss_scale: Loss that was minimised and its scale in pixels.
        focal: Cameras whose focal length and k1 are estimated with the pose, see
            :func:`~sfmkit.geometry.focal_refinement.refine_focal`; None for none.

    Raises:
        InputError: Shapes or types are wrong, there is a batch, a value is not finite, t is zero,
            the loss or `focal` is unknown, or the scale is outside 1e-100 to 1e100.
        DegenerateGeometryError: There are fewer matches than unknowns, or they do not determine
            the unknowns.
    """
    free = None if focal is None else focal_unknowns(focal, x1)
    _check_two_views(R, t, x1, x2, K1, K2, minimum=5 + (0 if free is None else 2 * free.shape[1]))
    t = t / t.norm()
    P1, P2 = inverse_intrinsics(K1), inverse_intrinsics(K2)
    E = hat(t) @ R
    F = P2.mT @ E @ P1
    # dF for each of the 5 pose parameters, then for 3 intrinsics of each camera
    turned = [P2.mT @ hat(t) @ hat(e) @ R @ P1 for e in torch.eye(3).to(R)]
    moved = [P2.mT @ hat(b) @ R @ P1 for b in tangent_basis(t).mT]
    first = [P2.mT @ E @ d for d in _inverse_derivatives(K1)]
    second = [d.mT @ E @ P1 for d in _inverse_derivatives(K2)]
    r, by_F, by_x1, by_x2 = _sampson(F, x1, x2)
    J = by_F @ torch.stack([d.flatten() for d in (*turned, *moved)], 1)
    k1, k2 = (
        (by_x * _radial_shift(x, K)).sum(-1, keepdim=True)
        for by_x, x, K in ((by_x1, x1, K1), (by_x2, x2, K2))
    )
    by_K1, by_K2 = (by_F @ torch.stack([d.flatten() for d in ds], 1) for ds in (first, second))
    J_camera = torch.cat((by_K1, k1, by_K2, k2), 1)
    if free is not None:
        J = torch.cat((J, J_camera[:, [0, 4]] @ free, J_camera[:, [3, 7]] @ free), 1)
        J_camera[:, [0, 4]] *= (free == 0).all(1)
        J_camera[:, [3, 7]] *= (free == 0).all(1)

    terms = loss_terms(loss, r.square(), loss_scale)
    # Half the loss has the gradient slope r J and the second derivative
    # (slope + 2 curvature r^2) J J^T.
    curvature = terms.slope + 2 * terms.curvature * r.square()
    if free is not None:
        # A focal length is often close to undetermined. There the curvature of single matches,
        # which a redescending loss makes negative, leaves no minimum; its mean keeps the scale.
        curvature = terms.slope * (curvature.sum() / terms.slope.sum())
    outer = J[:, :, None] * J[:, None, :]
    hessian = curvature[:, None, None] * outer
    H = hessian.sum(0)
    _check_determined(H)
    by_intrinsics = torch.linalg.solve_ex(H, -J.mT @ (curvature[:, None] * J_camera))[0]
    return Sensitivity((terms.slope * r)[:, None] * J, hessian, by_intrinsics)


def jackknife_covariance(sensitivity: Sensitivity, block: Tensor) -> Tensor:
    """Estimate the ``(P, P)`` covariance of a minimum with the delete-one-block jackknife.

    Args:
        sensitivity: Linearised cost, from :func:`linearise_pose`.
        block: ``(N,)`` int64, the block of every match.

    Returns:
        The covariance; infinite if there are fewer than two blocks, or if a direction of the pose
        is determined by one block alone.

    Raises:
        InputError: Shapes or types are wrong, or values are not finite.
    """
    _check_sensitivity(sensitivity)
    check_values(score=sensitivity.score, hessian=sensitivity.hessian)
    if not isinstance(block, Tensor) or block.dtype != torch.int64:
        raise InputError("block must be a tensor of int64, the number of the block of every match")
    _check_shape("block", block, tuple(sensitivity.score.shape[:1]))
    _, group = torch.unique(block, return_inverse=True)
    count = int(group.max()) + 1 if len(group) else 0
    kind, size = sensitivity.score, sensitivity.score.shape[1]
    if count < 2:
        return torch.full((size, size), torch.inf, dtype=kind.dtype, device=kind.device)
    score = kind.new_zeros(count, size).index_add(0, group, sensitivity.score)
    hessian = kind.new_zeros(count, size, size).index_add(0, group, sensitivity.hessian)
    rest, failed = torch.linalg.cholesky_ex(hessian.sum(0) - hessian)
    without = score.sum(0) - score
    moved = -torch.cholesky_solve(without[..., None], rest)[..., 0]
    moved = moved - moved.mean(0)
    return torch.where(failed.any(), torch.inf, (count - 1) / count * moved.mT @ moved)


def camera_covariance(
    sensitivity: Sensitivity, sigma1: Tensor, sigma2: Tensor, shared: bool
) -> Tensor:
    """Propagate the standard deviations of the intrinsics to the minimum, ``(P, P)``.

    Args:
        sensitivity: Linearised cost, from :func:`linearise_pose`.
        sigma1, sigma2: ``(4,)`` standard deviations in the order of :data:`INTRINSICS`.
        shared: Whether one camera took both images, so that its errors are the same in both.

    Raises:
        InputError: Shapes or types are wrong, or a value is not finite or a deviation negative.
    """
    _check_sensitivity(sensitivity)
    _check_sigmas(sensitivity, sigma1, sigma2)
    first, second = sensitivity.by_intrinsics[:, :4], sensitivity.by_intrinsics[:, 4:]
    columns = (
        (first + second) * sigma1 if shared else torch.cat((first * sigma1, second * sigma2), 1)
    )
    return columns @ columns.mT


def point_covariances(
    points: Tensor,
    derivatives: Tensor,
    before: Tensor,
    pose: Tensor,
    sensitivity: Sensitivity,
    sigma1: Tensor,
    sigma2: Tensor,
    shared: bool,
) -> Tensor:
    """Replace the pose part of the covariances of points, and add the part of the cameras.

    Args:
        points: ``(N, 3, 3)`` covariances of the points, including the uncertainty of the pose.
        derivatives: ``(N, 3, 13)`` derivatives of the points, from :func:`point_derivatives`.
        before: ``(5, 5)`` covariance of the pose that `points` includes.
        pose: ``(5, 5)`` covariance of the pose to include instead, without the part of the cameras.
        sensitivity: Linearised cost, from :func:`linearise_pose`.
        sigma1, sigma2, shared: As for :func:`camera_covariance`.

    Raises:
        InputError: Shapes or types are wrong, a deviation is negative, or a value is not finite.
            Values of `points` and `derivatives` may be NaN or infinite, which affects only their
            own point.
    """
    _check_sensitivity(sensitivity)
    _check_sigmas(sensitivity, sigma1, sigma2)
    check_matrices(sensitivity.by_intrinsics, shape=(5, 5), before=before, pose=pose)
    check_kind(by_intrinsics=sensitivity.by_intrinsics, points=points, derivatives=derivatives)
    n = len(points) if points.ndim else 0
    for name, a, shape in (
        ("points", points, (n, 3, 3)),
        ("derivatives", derivatives, (n, 3, 13)),
        ("before", before, (5, 5)),
        ("pose", pose, (5, 5)),
    ):
        _check_shape(name, a, shape)
    by_pose = derivatives[..., :5]
    # An error of a camera moves a point directly, and also through the pose.
    by_camera = derivatives[..., 5:] + by_pose @ sensitivity.by_intrinsics
    first, second = by_camera[..., :4], by_camera[..., 4:]
    columns = (
        (first + second) * sigma1 if shared else torch.cat((first * sigma1, second * sigma2), -1)
    )
    return points + by_pose @ (pose - before) @ by_pose.mT + columns @ columns.mT


def point_derivatives(
    R: Tensor, t: Tensor, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor
) -> Tensor:
    """Differentiate triangulated points with respect to the pose and the intrinsics.

    The derivatives are central differences in double precision, whose error of about 1e-9 is
    irrelevant for a covariance. Forward-mode differentiation takes twice the time for 29,000
    points, and three more seconds on its first use (torch 2.15).

    Args:
        R, t, x1, x2, K1, K2: As for :func:`linearise_pose`.

    Returns:
        ``(N, 3, 13)`` derivatives with respect to the five parameters of the pose, the intrinsics
        of camera 1 and the intrinsics of camera 2 (:data:`INTRINSICS`). The points are in the frame
        of camera 1, in baselines.

    Raises:
        InputError: Shapes or types are wrong, there is a batch, a value is not finite, or t is
            zero.
    """
    _check_two_views(R, t, x1, x2, K1, K2)
    kind = R.dtype
    R, t, x1, x2, K1, K2 = (a.double() for a in (R, t, x1, x2, K1, K2))
    t = t / t.norm()
    basis = tangent_basis(t)
    xn1, xn2 = normalize(x1, K1), normalize(x2, K2)
    rays1, rays2 = _rays_by_intrinsics(x1, K1), _rays_by_intrinsics(x2, K2)

    def by_pose(theta: Tensor) -> Tensor:
        turned, moved = so3_exp(theta[:3]) @ R, sphere_exp(t, basis @ theta[3:])
        return triangulate_optimal(xn1, xn2, turned, moved)

    columns = [
        *_central_differences(by_pose, 5, R),
        *_central_differences(lambda error: triangulate_optimal(rays1(error), xn2, R, t), 4, R),
        *_central_differences(lambda error: triangulate_optimal(xn1, rays2(error), R, t), 4, R),
    ]
    return torch.stack(columns, -1).to(kind)


def _central_differences(
    function: Callable[[Tensor], Tensor], n: int, like: Tensor
) -> Iterator[Tensor]:
    """Yield the derivatives at zero of a function with respect to its `n` arguments."""
    for step in _STEP * torch.eye(n, dtype=like.dtype, device=like.device):
        yield (function(step) - function(-step)) / (2 * _STEP)


def _rays_by_intrinsics(x: Tensor, K: Tensor) -> Callable[[Tensor], Tensor]:
    """Return a function that maps errors of the intrinsics to the rays of pixels.

    The errors are in the order of :data:`INTRINSICS`; the rays are normalised coordinates
    ``(N, 2)``.
    """
    radial, inverse = _radial_shift(x, K), inverse_intrinsics(K).mT

    def rays(error: Tensor) -> Tensor:
        xn = to_homogeneous(x + radial * error[3] - error[1:3]) @ inverse
        return xn[:, :2] / (1 + error[0])

    return rays


def image_blocks(x: Tensor, size_wh: tuple[int, int], across: int = 12) -> Tensor:
    """Return the numbers of the square image tiles that contain points, ``(N,)`` int64.

    Args:
        x: ``(N, 2)`` pixels. Points outside the image belong to the nearest tile.
        size_wh: Width and height of the image in pixels.
        across: Number of tiles along the longest side. With twelve, the tiles of a photograph of
            3072 pixels have 256 pixels.

    Raises:
        InputError: A shape or type is wrong, a value is not finite, or the size or the number of
            tiles is not positive.
    """
    check_points(x=x)
    if x.ndim != 2 or across < 1 or min(size_wh) < 1:
        raise InputError(
            f"x must be (N, 2), size_wh and across positive, not {tuple(x.shape)}, {size_wh}, "
            f"{across}"
        )
    side = max(size_wh) / across
    column, row = (x / side).floor().clamp(0, across - 1).long().unbind(-1)
    return row * across + column


def _check_two_views(
    R: Tensor, t: Tensor, x1: Tensor, x2: Tensor, K1: Tensor, K2: Tensor, minimum: int = 0
) -> None:
    check_points(minimum, x1=x1, x2=x2)
    check_pose(R, t, x1)
    check_intrinsics(x1, K1=K1, K2=K2)
    if x1.ndim != 2 or max(R.ndim, K1.ndim, K2.ndim) > 2 or t.ndim > 1:
        raise InputError("batches are not supported; use torch.func.vmap")


def _check_determined(H: Tensor) -> None:
    """Raise DegenerateGeometryError if the Hessian is singular up to rounding."""
    if _traced():
        return
    root = H.detach().diagonal().abs().sqrt()
    scaled = (H.detach() / root / root[:, None]).double()
    finite = bool(scaled.isfinite().all())
    least = float(torch.linalg.eigvalsh(scaled).abs().min()) if finite else 0.0
    if least < 1e3 * torch.finfo(H.dtype).eps:
        raise DegenerateGeometryError("these matches do not determine the pose")


def _check_sensitivity(sensitivity: Sensitivity) -> None:
    check_kind(
        score=sensitivity.score,
        hessian=sensitivity.hessian,
        by_intrinsics=sensitivity.by_intrinsics,
    )
    n, size = sensitivity.score.shape if sensitivity.score.ndim == 2 else (0, 5)
    size = min(max(size, 5), 9)
    for name, a, shape in (
        ("score", sensitivity.score, (n, size)),
        ("hessian", sensitivity.hessian, (n, size, size)),
        ("by_intrinsics", sensitivity.by_intrinsics, (size, 8)),
    ):
        _check_shape(name, a, shape)
    check_values(by_intrinsics=sensitivity.by_intrinsics)


def _check_shape(name: str, a: Tensor, shape: tuple[int, ...]) -> None:
    if a.shape != shape:
        raise InputError(f"{name} must have shape {shape}, not {tuple(a.shape)}")


def _check_sigmas(sensitivity: Sensitivity, sigma1: Tensor, sigma2: Tensor) -> None:
    check_kind(by_intrinsics=sensitivity.by_intrinsics, sigma1=sigma1, sigma2=sigma2)
    check_values(sigma1=sigma1, sigma2=sigma2)
    for name, sigma in (("sigma1", sigma1), ("sigma2", sigma2)):
        _check_shape(name, sigma, (4,))
        if not _traced() and bool((sigma < 0).any()):
            raise InputError(f"{name} must not be negative")


def _sampson(F: Tensor, x1: Tensor, x2: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the signed Sampson distances ``(N,)`` and their derivatives.

    The derivatives are with respect to F ``(N, 9)``, x1 ``(N, 2)`` and x2 ``(N, 2)``.
    """
    y1, y2 = to_homogeneous(x1), to_homogeneous(x2)
    l2, l1 = y1 @ F.mT, y2 @ F  # epipolar lines in image 2 and in image 1
    q = l2[:, :2].square().sum(-1) + l1[:, :2].square().sum(-1)
    e, root = (y2 * l2).sum(-1), q.sqrt()
    flat = torch.tensor([1.0, 1.0, 0.0], dtype=F.dtype, device=F.device)
    by_F = y2[:, :, None] * y1[:, None, :] / root[:, None, None]
    half = (l2 * flat)[:, :, None] * y1[:, None, :] + y2[:, :, None] * (l1 * flat)[:, None, :]
    by_F = by_F - (e / (q * root))[:, None, None] * half
    # q depends on the points too; for inliers this second-order effect is negligible.
    return e / root, by_F.flatten(1), l1[:, :2] / root[:, None], l2[:, :2] / root[:, None]


def _inverse_derivatives(K: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the derivatives of ``K^-1`` with respect to the relative focal length, cx and cy."""
    P = inverse_intrinsics(K)
    focal, cx, cy = torch.zeros((3, 3, 3), dtype=K.dtype, device=K.device)
    focal[0, 0] = focal[0, 1] = focal[1, 1] = cx[0, 2] = cy[1, 2] = 1
    return -P @ (focal * K) @ P, -P @ cx @ P, -P @ cy @ P


def _radial_shift(x: Tensor, K: Tensor) -> Tensor:
    """Return the derivative ``(N, 2)`` of undistorted pixels with respect to k1, at k1 = 0."""
    xn = to_homogeneous(x) @ inverse_intrinsics(K).mT
    r2 = xn[:, :2].square().sum(-1, keepdim=True)
    return -(r2 * xn[:, :2]) @ K[:2, :2].mT
