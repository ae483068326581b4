"""Relative poses ``X2 = R X1 + t``: choice among candidates, and errors against the truth.

Angles are computed by arc tangents: an arc cosine has no digits left near 0 and 180 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from kornia.geometry.epipolar import relative_camera_motion
from kornia.geometry.liegroup import Se3, So3
from kornia.geometry.quaternion import Quaternion
from torch import Tensor
from torch.autograd import forward_ad

from ..errors import InputError
from ._rays import components, cross, dot, image_ray, rotated_ray
from .checks import _traced, check_kind, check_matrices, check_points, check_shapes


def cheirality(xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor) -> Tensor:
    """Return which matches lie in front of both cameras, ``(*B, N)`` bool.

    Computed from the signs of the two depths at the midpoint of the shortest segment between the
    rays, without triangulation or division. Parallel rays (a point at infinity) count as not in
    front: they decide nothing. kornia 0.9.0 has no counterpart.

    Args:
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        R, t: ``(*B, 3, 3)``, ``(*B, 3)``. For the four candidates ``(*B, 4, 3, 3)``, ``(*B, 4, 3)``
            give the points a dimension to broadcast against, ``xn1[..., None, :, :]``; the mask is
            then ``(*B, 4, N)``.

    Raises:
        InputError: on shapes, dtypes or devices that do not fit, NaN, or a zero t.

    Source: Hartley and Zisserman, 2nd ed., section 9.6.3; depths as triple products of the rays.
    """
    check_points(xn1=xn1, xn2=xn2)
    check_pose(R, t, like=xn1)
    p = rotated_ray(R.double(), *xn1.double().unbind(-1))
    q = image_ray(*xn2.double().unbind(-1))
    c = components(t.double())
    n = cross(p, q)
    return (dot(cross(q, c), n) > 0) & (dot(cross(p, c), n) > 0)


def choose_pose(
    R4: Tensor, t4: Tensor, xn1: Tensor, xn2: Tensor, weights: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Choose, per batch item, the candidate pose with most matches in front of both cameras.

    kornia's ``motion_from_essential_choose_solution`` (0.9.0) takes E, not candidates. It
    triangulates all matches once per candidate, which takes about 30 times as long as
    :func:`decompose_essential` and this function (``benchmarks/geometry.py --peers``).

    Args:
        R4, t4: ``(*B, C, 3, 3)``, ``(*B, C, 3)`` candidates (C = 4 from an essential matrix).
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        weights: ``(*B, N)`` non-negative, counted instead of ones (inliers only: pass the mask as 0
            and 1).

    Returns:
        R ``(*B, 3, 3)``, t ``(*B, 3)`` and the counts ``(*B, C)`` of all candidates. When two
        counts are about equal the matches do not decide (pure rotation).

    Raises:
        InputError: as :func:`cheirality`.
    """
    check_points(weights=weights, xn1=xn1, xn2=xn2)
    check_kind(R4=R4, t4=t4)
    count = R4.shape[-3] if R4.ndim > 2 else 1
    if count == 0:
        raise InputError("R4 holds no candidates")
    check_shapes((count, 3, 3), xn1, R4=R4)
    check_shapes((count, 3), xn1, t4=t4)
    in_front = cheirality(xn1[..., None, :, :], xn2[..., None, :, :], R4, t4)
    if weights is None:
        counts = in_front.sum(-1)
    else:
        counts = torch.where(in_front, weights[..., None, :], 0.0).sum(-1)
    best = counts.argmax(-1)[..., None]
    batch = best.shape[:-1]
    R4, t4 = R4.expand(*batch, *R4.shape[-3:]), t4.expand(*batch, *t4.shape[-2:])
    R = torch.take_along_dim(R4, best[..., None, None], -3).squeeze(-3)
    t = torch.take_along_dim(t4, best[..., None], -2).squeeze(-2)
    return R, t, counts


def relative_pose(R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> tuple[Tensor, Tensor]:
    """Return the pose R ``(*B, 3, 3)``, t ``(*B, 3)`` of camera 2 from camera 1.

    Both are given from the world, ``Xi = Ri X + ti``. Computed by kornia's
    ``relative_camera_motion``.

    Raises:
        InputError: shapes, dtypes, devices, NaN.
    """
    check_matrices(R1=R1, R2=R2)
    check_matrices(R1, shape=(3,), t1=t1, t2=t2)
    shapes = (R1.shape[:-2], R2.shape[:-2], t1.shape[:-1], t2.shape[:-1])
    batch = torch.broadcast_shapes(*shapes)
    R1, R2 = (R.expand(*batch, 3, 3) for R in (R1, R2))
    t1, t2 = (t.expand(*batch, 3)[..., None] for t in (t1, t2))
    R, t = relative_camera_motion(R1, t1, R2, t2)
    return R, t[..., 0]


def se3_from_pose(R: Tensor, t: Tensor) -> Se3:
    """Return a pose as kornia's ``Se3``, whose action on points is ``R X + t``.

    Args:
        R: ``(3, 3)`` or ``(B, 3, 3)``: Se3 takes at most one batch dimension. t: ``(3,)`` or
            ``(B, 3)``.

    Raises:
        InputError: shapes, dtypes, devices, NaN, or forward mode: kornia (0.9.0) stores t as a
            parameter and loses its tangent.
    """
    check_matrices(R=R)
    check_matrices(R, shape=(3,), t=t)
    if forward_ad.unpack_dual(t).tangent is not None:
        raise InputError("Se3 does not support forward mode; use reverse mode (jacrev)")
    if R.ndim > 3 or t.ndim != R.ndim - 1:
        raise InputError(
            "R and t must have shapes (3, 3) and (3,), or (B, 3, 3) and (B, 3), "
            f"not {tuple(R.shape)} and {tuple(t.shape)}"
        )
    return Se3(So3(Quaternion.from_matrix(R)), t)


def pose_from_se3(pose: Se3) -> tuple[Tensor, Tensor]:
    """Return R ``(*B, 3, 3)`` and t ``(*B, 3)`` of kornia's ``Se3``; see :func:`se3_from_pose`."""
    M = pose.matrix()
    return M[..., :3, :3], M[..., :3, 3]


def rotation_error(R1: Tensor, R2: Tensor) -> Tensor:
    """Return the angle of ``R1^T R2`` in degrees, ``(*B,)``, in [0, 180].

    The derivative at equal rotations is zero. kornia 0.9.0 has no counterpart.
    """
    check_matrices(R1=R1, R2=R2)
    D = R1.double().mT @ R2.double()
    axis = torch.stack(
        (D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]), -1
    )
    cosine = D.diagonal(dim1=-2, dim2=-1).sum(-1) - 1
    return torch.rad2deg(torch.atan2(_length(axis), cosine)).to(R1.dtype)


def translation_error(t1: Tensor, t2: Tensor, sign_invariant: bool = False) -> Tensor:
    """Return the angle between two translations in degrees, ``(*B,)``, in [0, 180].

    Their lengths do not matter; NaN where one of them is zero. kornia 0.9.0 has no counterpart.

    Args:
        sign_invariant: treat t and -t as equal, result in [0, 90]: an essential matrix alone does
            not determine the sign.

    Raises:
        InputError: a translation is zero; shapes, dtypes, devices, NaN.
    """
    check_matrices(shape=(3,), t1=t1, t2=t2)
    a, b = torch.broadcast_tensors(t1.double(), t2.double())
    a, b = a / a.norm(dim=-1, keepdim=True), b / b.norm(dim=-1, keepdim=True)
    cosine = (a * b).sum(-1)
    if sign_invariant:
        cosine = cosine.abs()
    return torch.rad2deg(torch.atan2(_length(torch.linalg.cross(a, b, dim=-1)), cosine)).to(
        t1.dtype
    )


def pose_auc(errors_deg: Tensor, thresholds: Sequence[float]) -> Tensor:
    """Return the area under the recall curve up to each threshold, divided by the threshold.

    The exact area under the step curve "share of pairs with an error of at most e", which is the
    mean of ``max(0, 1 - error / threshold)``: no bins and no interpolation between pairs. kornia
    0.9.0 has no counterpart.

    Args:
        errors_deg: ``(*B, N)`` one error per pair, degrees: usually the larger of rotation and
            translation error. NaN and infinity count as failures.
        thresholds: degrees, positive.

    Returns:
        ``(*B, len(thresholds))`` in [0, 1].

    Raises:
        InputError: no errors, errors that are not floats, or a threshold that is not positive.
    """
    check_kind(errors_deg=errors_deg)
    if errors_deg.ndim < 1 or errors_deg.shape[-1] == 0:
        raise InputError("errors_deg is empty: the area needs at least one pair")
    thr = torch.as_tensor(thresholds, dtype=errors_deg.dtype, device=errors_deg.device)
    if thr.ndim != 1 or not bool((thr > 0).all()):
        raise InputError(f"thresholds must be a list of positive degrees, not {thresholds}")
    failed = ~torch.isfinite(errors_deg)
    e = torch.where(failed, torch.inf, errors_deg)[..., None]
    return (1 - e / thr).clamp_min(0).mean(-2)


def check_pose(R: Tensor, t: Tensor, like: Tensor | None = None) -> None:
    """Raise InputError unless R is ``(*B, 3, 3)``, t ``(*B, 3)`` and not zero, both finite."""
    check_matrices(like, R=R)
    check_matrices(R if like is None else like, shape=(3,), t=t)
    if not _traced() and bool((t == 0).all(-1).any()):
        raise InputError("t is zero: without a baseline two views determine no depth")


def _length(v: Tensor) -> Tensor:
    """Return |v| with derivative zero, not NaN, at zero."""
    square = (v * v).sum(-1)
    zero = square == 0
    return torch.where(zero, 0.0, torch.where(zero, 1.0, square).sqrt())
