"""Similarity transformations: scale, rotation and translation."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError
from .checks import _traced, check_kind, check_values


class Similarity(NamedTuple):
    """The similarity transformation ``y = s R x + t``.

    Attributes:
        s: (*B,) positive scale.
        R: (*B, 3, 3) rotation.
        t: (*B, 3) translation.
    """

    s: Tensor
    R: Tensor
    t: Tensor

    def apply(self, x: Tensor) -> Tensor:
        """Apply the similarity to (*B, N, 3) points."""
        return self.s[..., None, None] * x @ self.R.mT + self.t[..., None, :]

    def inverse(self) -> Similarity:
        """Return the inverse similarity."""
        s, R = 1 / self.s, self.R.mT
        return Similarity(s, R, -s[..., None] * (R @ self.t[..., None])[..., 0])


def fit_similarity(x: Tensor, y: Tensor) -> Similarity:
    """Fit the similarity that minimises the sum of squared distances of ``s R x + t`` from y.

    kornia 0.9.0 has no counterpart.

    Args:
        x, y: (*B, N, 3) corresponding points.

    Raises:
        InputError: The shapes or types do not fit, or values are not finite.
        DegenerateGeometryError: There are fewer than three pairs, or all points of `x` or of `y`
            lie on a line, so that the rotation about it is not determined.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", PAMI 1991, equations 40 to 42.
    """
    check_kind(x=x, y=y)
    if x.shape != y.shape or x.ndim < 2 or x.shape[-1] != 3:
        raise InputError(
            f"x and y must both have shape (*B, N, 3), not {tuple(x.shape)} and {tuple(y.shape)}"
        )
    if x.shape[-2] < 3:
        raise DegenerateGeometryError(
            "a similarity needs three pairs of points", pairs=x.shape[-2], needed=3
        )
    check_values(x=x, y=y)
    mean_x, mean_y = x.mean(-2, keepdim=True), y.mean(-2, keepdim=True)
    cx, cy = x - mean_x, y - mean_y
    product = cy.mT @ cx
    if not _traced() and not bool(product.isfinite().all()):
        raise DegenerateGeometryError(
            "the products of these coordinates are outside the range of floats; scale them"
        )
    U, D, Vh = torch.linalg.svd(product)
    spread = torch.linalg.svdvals(torch.stack([cx, cy]))
    if not _traced() and bool((spread[..., 1] <= 1e-9 * spread[..., 0]).any()):
        raise DegenerateGeometryError(
            "the points lie on a line, so the rotation about it is not determined"
        )
    turn = torch.linalg.det(U @ Vh).sign()  # a rotation, not a reflection
    sign = torch.stack((torch.ones_like(turn), torch.ones_like(turn), turn), -1)
    R = U @ (sign[..., None] * Vh)
    s = (D * sign).sum(-1) / cx.square().sum((-2, -1))
    t = mean_y[..., 0, :] - s[..., None] * (R @ mean_x.mT)[..., 0]
    return Similarity(s, R, t)
