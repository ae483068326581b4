"""Triangulated points with their provenance and accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InputError
from ._checks import check_tensor


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Triangulated points in the frame of camera 1, in units of the baseline.

    Attributes:
        xyz: (M, 3) float64 positions: x right, y down, z forward.
        rgb: (M, 3) uint8 colours from image 1.
        operator_id, operator_mask: (M,) int64, as in :class:`Correspondences`.
        operators: Names of the operators.
        reprojection_error: (M,) float64 root mean square error over the two images, pixels.
        parallax: (M,) float64 angles between the two rays, degrees.
        match: (M,) int64 rows of the Correspondences from which the points were triangulated.
        covariance: (M, 3, 3) float64 covariances in squared baselines, None if not computed.
    """

    xyz: Tensor
    rgb: Tensor
    operator_id: Tensor
    operator_mask: Tensor
    operators: tuple[str, ...]
    reprojection_error: Tensor
    parallax: Tensor
    match: Tensor
    covariance: Tensor | None = None

    def __post_init__(self) -> None:
        check_tensor("PointCloud", "xyz", self.xyz, (None, 3), torch.float64)
        n = len(self.xyz)
        check_tensor("PointCloud", "rgb", self.rgb, (n, 3), torch.uint8)
        for name in ("operator_id", "operator_mask", "match"):
            check_tensor("PointCloud", name, getattr(self, name), (n,), torch.int64)
        for name in ("reprojection_error", "parallax"):
            check_tensor("PointCloud", name, getattr(self, name), (n,), torch.float64)
        if not torch.isfinite(self.xyz).all():
            raise InputError("PointCloud.xyz holds NaN or infinite values")
        if self.covariance is not None:
            check_tensor("PointCloud", "covariance", self.covariance, (n, 3, 3), torch.float64)

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self):,} points from {', '.join(self.operators)})"

    def found_by(self, operator: str) -> Tensor:
        """Return which points `operator` found, alone or with others, (M,) bool."""
        return ((self.operator_mask >> self.operators.index(operator)) & 1).bool()
