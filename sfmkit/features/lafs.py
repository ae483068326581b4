"""Conversion of :class:`sfmkit.types.Features` to and from local affine frames (LAFs).

A LAF of kornia is a 2 x 3 matrix per keypoint. Its last column is the position, and the other
columns map the unit circle to the described neighbourhood. Features store the diameter of that
neighbourhood and an angle from x towards y (clockwise on the screen); kornia stores the radius and
measures angles in the opposite direction.
"""

from __future__ import annotations

import numpy as np
import torch
from kornia.feature import (
    get_laf_center,
    get_laf_orientation,
    get_laf_scale,
    laf_from_center_scale_ori,
)
from torch import Tensor

from ..errors import InputError
from ..types import Features


def lafs_from_features(features: Features) -> Tensor:
    """Convert the keypoints to LAFs, (1, N, 2, 3) float32."""
    xy, scales, angles = (
        torch.tensor(a, dtype=torch.float32)
        for a in (features.keypoints, features.scales, features.angles)
    )
    radius, degrees = scales[None, :, None, None] / 2, -torch.rad2deg(angles)[None, :, None]
    return laf_from_center_scale_ori(xy.reshape(1, -1, 2), radius, degrees)


def keypoints_from_lafs(lafs: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert LAFs to keypoints (N, 2), scales (N,) and angles (N,).

    The conventions are those of :class:`Features`. The affine shape of a LAF is lost: the scale is
    the diameter of the circle of equal area, and the angle is that of the first axis of the frame.

    Args:
        lafs: (1, N, 2, 3) local affine frames.

    Raises:
        InputError: The shape is wrong, or a value is NaN.
    """
    if lafs.ndim != 4 or lafs.shape[0] != 1 or tuple(lafs.shape[2:]) != (2, 3):
        raise InputError(f"lafs must have shape (1, N, 2, 3), not {tuple(lafs.shape)}")
    lafs = lafs.detach().cpu().float()
    if not bool(lafs.isfinite().all()):
        raise InputError("lafs holds NaN or infinite values; drop those entries first")
    xy, radius = get_laf_center(lafs)[0], get_laf_scale(lafs)[0, :, 0, 0]
    angles = -torch.deg2rad(get_laf_orientation(lafs)[0, :, 0])
    return xy.numpy(), (2 * radius).numpy(), angles.numpy()
