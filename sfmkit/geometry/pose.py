"""Relative poses: which of the four candidates is real, and how far a pose is from the truth.

``X2 = R X1 + t``. Angles come from arc tangents throughout: an arc cosine has no digits left near 0
and 180 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..errors import InputError
from ._rays import components, cross, dot, image_ray, rotated_ray
from .checks import _traced, check_matrices, check_points


def cheirality(xn1: Tensor, xn2: Tensor, R: Tensor, t: Tensor) -> Tensor:
    """Which matches lie in front of both cameras, ``(*B, N)`` bool.

    Only the signs of the two depths at the midpoint of the shortest segment between the rays;
    nothing is triangulated and nothing divided. Parallel rays (a point at infinity) count as not in
    front: they decide nothing.

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
    """Of each batch item's candidate poses, the one with most matches in front of both cameras.

    Args:
        R4, t4: ``(*B, C, 3, 3)``, ``(*B, C, 3)`` candidates (C = 4 from an essential matrix).
        xn1, xn2: ``(*B, N, 2)`` normalised image coordinates.
        weights: ``(*B, N)`` non-negative, counted instead of ones (inliers only: pass the mask as 0
            and 1).

    Returns:
        R ``(*B, 3, 3)``, t ``(*B, 3)`` and the counts ``(*B, C)`` of all candidates. The choice is
        as good as the
        counts are apart: a runner-up with as many votes means that the matches do not decide (pure
            rotation).

    Raises:
        InputError: as :func:`cheirality`.
    """
    in_front = cheirality(xn1[..., None, :, :], xn2[..., None, :, :], R4, t4)
    if weights is None:
        counts = in_front.sum(-1)
    else:
        check_points(weights=weights, xn1=xn1)
        counts = torch.where(in_front, weights[..., None, :], 0.0).sum(-1)
    best = counts.argmax(-1)[..., None]
    batch = best.shape[:-1]
    R4, t4 = R4.expand(*batch, *R4.shape[-3:]), t4.expand(*batch, *t4.shape[-2:])
    R = torch.take_along_dim(R4, best[..., None, None], -3).squeeze(-3)
    t = torch.take_along_dim(t4, best[..., None], -2).squeeze(-2)
    return R, t, counts


def relative_pose(R1: Tensor, t1: Tensor, R2: Tensor, t2: Tensor) -> tuple[Tensor, Tensor]:
    """The pose ``(*B, 3, 3)``, ``(*B, 3)`` of camera 2 from camera 1, both given from the world,
    ``Xi = Ri X + ti``."""
    R = R2 @ R1.mT
    return R, t2 - (R @ t1[..., None])[..., 0]


def rotation_error(R1: Tensor, R2: Tensor) -> Tensor:
    """The angle of ``R1^T R2`` in degrees, ``(*B,)``, in [0, 180]; the derivative at equal
    rotations is zero."""
    check_matrices(R1=R1, R2=R2)
    D = R1.double().mT @ R2.double()
    axis = torch.stack(
        (D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]), -1
    )
    cosine = D.diagonal(dim1=-2, dim2=-1).sum(-1) - 1
    return torch.rad2deg(torch.atan2(_length(axis), cosine)).to(R1.dtype)


def translation_error(t1: Tensor, t2: Tensor, sign_invariant: bool = False) -> Tensor:
    """The angle between two translations in degrees, ``(*B,)``, in [0, 180]; their lengths do not
    matter.

    Args:
        sign_invariant: take t and -t for the same, in [0, 90] (for what an essential matrix alone
            can say).
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
    """The area under the recall curve up to each threshold, over the threshold;
    ``(*B, len(thresholds))`` in [0, 1].

    The exact area under the step curve "share of pairs with an error of at most e", which is the
    mean of ``max(0, 1 - error / threshold)``: no bins and no interpolation between pairs.

    Args:
        errors_deg: ``(*B, N)`` one error per pair, degrees: usually the larger of rotation and
            translation error. NaN and infinity count as failures.
        thresholds: degrees.
    """
    failed = ~torch.isfinite(errors_deg)
    e = torch.where(failed, torch.inf, errors_deg)[..., None]
    thr = torch.tensor(thresholds, dtype=errors_deg.dtype, device=errors_deg.device)
    return (1 - e / thr).clamp_min(0).mean(-2)


def check_pose(R: Tensor, t: Tensor, like: Tensor | None = None) -> None:
    """Raise InputError unless R is ``(*B, 3, 3)`` and t ``(*B, 3)``, finite, of one kind, and t
    nowhere zero."""
    check_matrices(like, R=R)
    check_matrices(R, shape=(3,), t=t)
    if not _traced() and bool((t == 0).all(-1).any()):
        raise InputError("t is zero: without a baseline two views determine no depth")


def _length(v: Tensor) -> Tensor:
    """|v| with derivative zero, not NaN, at zero."""
    square = (v * v).sum(-1)
    zero = square == 0
    return torch.where(zero, 0.0, torch.where(zero, 1.0, square).sqrt())
