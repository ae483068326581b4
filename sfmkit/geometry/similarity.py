"""Similarities: a rotation, a scale and a shift."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError
from .checks import check_kind, check_values


class Similarity(NamedTuple):
    """``y = s R x + t``.

    Attributes:
        s: (*B,) positive scale.
        R: (*B, 3, 3) rotation.
        t: (*B, 3) shift.
    """

    s: Tensor
    R: Tensor
    t: Tensor

    def apply(self, x: Tensor) -> Tensor:
        """(*B, N, 3) points, moved."""
        return self.s[..., None, None] * x @ self.R.mT + self.t[..., None, :]

    def inverse(self) -> Similarity:
        """The way back."""
        s, R = 1 / self.s, self.R.mT
        return Similarity(s, R, -s[..., None] * (R @ self.t[..., None])[..., 0])


def fit_similarity(x: Tensor, y: Tensor) -> Similarity:
    """The similarity that moves `x` nearest to `y`, in the sum of squared distances (Umeyama 1991,
    equations 40 to 42).

    Args:
        x, y: (*B, N, 3) corresponding points.

    Raises:
        InputError: the shapes or types do not fit, or values are not finite.
        DegenerateGeometryError: fewer than three pairs, or all points of `x` or of `y` on a line:
            the rotation about it is open.
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
    U, D, Vh = torch.linalg.svd(cy.mT @ cx)
    spread = torch.linalg.svdvals(torch.stack([cx, cy]))
    if bool((spread[..., 1] <= 1e-9 * spread[..., 0]).any()):
        raise DegenerateGeometryError(
            "the points lie on a line, which leaves the rotation about it open"
        )
    sign = torch.ones_like(D)
    sign[..., 2] = torch.linalg.det(U @ Vh).sign()  # a rotation, not a reflection
    R = U @ (sign[..., None] * Vh)
    s = (D * sign).sum(-1) / cx.square().sum((-2, -1))
    t = mean_y[..., 0, :] - s[..., None] * (R @ mean_x.mT)[..., 0]
    return Similarity(s, R, t)
