"""Relative poses ``X2 = R X1 + t``: choice among candidates, and errors against the truth.

Angles are computed by arc tangents, because an arc cosine loses its precision near 0 and 180
degrees.
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

    The result follows from the signs of the two depths at the midpoint of the shortest segment
    between the rays, without triangulation or division. Parallel rays (a point at infinity) are
    regarded as not in front, because they do not distinguish the candidates. kornia 0.9.0 has no
    counterpart.

    Args:
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        R, t: ``(*B, 3, 3)``, ``(*B, 3)`` pose. For four candidates ``(*B, 4, 3, 3)``,
            ``(*B, 4, 3)``, add a dimension to the points, ``xn1[..., None, :, :]``; the mask is
            then ``(*B, 4, N)``.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, a value is NaN, or t is zero.

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
    """Return the candidate pose with the most matches in front of both cameras.

    kornia's ``motion_from_essential_choose_solution`` (0.9.0) takes E, not candidates. It
    triangulates all matches once per candidate, which takes about 30 times as long as
    :func:`decompose_essential` and this function (``benchmarks/geometry.py --peers``).

    Args:
        R4, t4: ``(*B, C, 3, 3)``, ``(*B, C, 3)`` candidates (C = 4 for an essential matrix).
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        weights: ``(*B, N)`` weights of the matches, not negative; 0 and 1 to count only inliers.

    Returns:
        R ``(*B, 3, 3)``, t ``(*B, 3)`` and the counts ``(*B, C)`` of all candidates. If two counts
        are almost equal, the matches do not determine the pose (pure rotation).

    Raises:
        InputError: As for :func:`cheirality`.
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
    """Return the pose R ``(*B, 3, 3)``, t ``(*B, 3)`` of camera 2 with respect to camera 1.

    The given poses map the world to the cameras, ``Xi = Ri X + ti``. Computed by kornia's
    ``relative_camera_motion``.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.
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
    """Convert a pose to a kornia ``Se3``, whose action on points is ``R X + t``.

    Args:
        R: ``(3, 3)`` or ``(B, 3, 3)`` rotation; Se3 supports at most one batch dimension.
        t: ``(3,)`` or ``(B, 3)`` translation.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, a value is NaN, or forward mode is used:
            kornia (0.9.0) stores t as a parameter and loses its tangent.
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
    """Convert a kornia ``Se3`` to R ``(*B, 3, 3)`` and t ``(*B, 3)``.

    The inverse of :func:`se3_from_pose`.
    """
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

    The lengths do not matter. The angle is NaN where a translation is zero. kornia 0.9.0 has no
    counterpart.

    Args:
        t1, t2: ``(*B, 3)`` translations.
        sign_invariant: Whether t and -t are equal, so that the result is in [0, 90]; an essential
            matrix alone does not determine the sign.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, or a value is NaN.
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

    The area is the exact area under the step curve "share of pairs with an error of at most e",
    which is the mean of ``max(0, 1 - error / threshold)``, without bins and without interpolation
    between pairs. kornia 0.9.0 has no counterpart.

    Args:
        errors_deg: ``(*B, N)`` error of each pair in degrees, usually the larger of the rotation
            and translation errors. NaN and infinity count as failures.
        thresholds: Positive thresholds in degrees.

    Returns:
        ``(*B, len(thresholds))`` in [0, 1].

    Raises:
        InputError: There are no errors, they are not floats, or a threshold is not positive.
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
    """Raise InputError unless R ``(*B, 3, 3)`` and t ``(*B, 3)`` are finite and t is not zero."""
    check_matrices(like, R=R)
    check_matrices(R if like is None else like, shape=(3,), t=t)
    if not _traced() and bool((t == 0).all(-1).any()):
        raise InputError("t is zero: without a baseline two views determine no depth")


def _length(v: Tensor) -> Tensor:
    """Return |v|, whose derivative at zero is zero instead of NaN."""
    square = (v * v).sum(-1)
    zero = square == 0
    return torch.where(zero, 0.0, torch.where(zero, 1.0, square).sqrt())
