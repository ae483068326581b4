"""Uncertainty of a pose and its points, with its parts: pixel noise, image regions, cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.block_covariance import (
    camera_covariance,
    image_blocks,
    jackknife_covariance,
    linearise_pose,
    point_covariances,
    point_derivatives,
)
from ..geometry.loss_kernels import Loss
from ..geometry.uncertainty import Uncertainty, sigma_degrees
from ..types import Camera

PIXELS, REGIONS, CAMERAS = "pixel noise", "image regions", "cameras"


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Covariances of a pose and of its points, and what they are made of.

    Attributes:
        pose: (5, 5) as in :class:`~sfmkit.geometry.uncertainty.Uncertainty`: errors that the
            matches of a region of the image share, plus errors of the cameras.
        points: (N, 3, 3) in camera 1, squared baselines.
        parts_deg: standard deviations of rotation and of translation direction, degrees, that each
            part gives alone. ``pixel noise`` supposes independent errors of single matches, and is
            contained in ``image regions``, which supposes independent errors of image tiles.
    """

    pose: Tensor
    points: Tensor
    parts_deg: Mapping[str, tuple[float, float]]


def pose_uncertainty(
    R: Tensor,
    t: Tensor,
    x1: Tensor,
    x2: Tensor,
    cameras: tuple[Camera, Camera],
    independent: Uncertainty,
    *,
    loss: Loss,
    loss_scale: float,
) -> PoseUncertainty:
    """Estimate the covariance of an adjusted pose and of its points.

    Args:
        R, t: (3, 3) and (3,) at the minimum of the robust cost.
        x1, x2: (N, 2) undistorted pixels of the inliers.
        independent: Covariances for independent errors of single matches.
        loss, loss_scale: As they were minimised.

    Where the inliers occupy too few tiles for a jackknife, errors of single matches stand in.
    """
    K1, K2 = (camera.tensors()[0] for camera in cameras)
    sensitivity = linearise_pose(R, t, x1, x2, K1, K2, loss=loss, loss_scale=loss_scale)
    regions = jackknife_covariance(sensitivity, image_blocks(x1, cameras[0].size_wh))
    if not bool(torch.isfinite(regions).all()):
        regions = independent.pose
    sigma1, sigma2 = (intrinsics_sigmas(camera) for camera in cameras)
    shared = _same(*cameras)
    of_cameras = camera_covariance(sensitivity, sigma1, sigma2, shared)
    points = point_covariances(
        independent.points,
        point_derivatives(R, t, x1, x2, K1, K2),
        independent.pose,
        regions,
        sensitivity,
        sigma1,
        sigma2,
        shared,
    )
    # points at infinity have no finite covariance
    points = torch.where(torch.isfinite(independent.points), points, independent.points)
    parts = {PIXELS: independent.pose, REGIONS: regions, CAMERAS: of_cameras}
    degrees = {name: sigma_degrees(part).tolist() for name, part in parts.items()}
    return PoseUncertainty(
        regions + of_cameras, points, {name: (r, t) for name, (r, t) in degrees.items()}
    )


def intrinsics_sigmas(camera: Camera) -> Tensor:
    """(4,) standard deviations of a camera in the order of ``block_covariance.INTRINSICS``."""
    sigma = camera.uncertainty
    return torch.tensor(
        [sigma.focal, sigma.principal_point, sigma.principal_point, sigma.k1], dtype=torch.float64
    )


def _same(camera1: Camera, camera2: Camera) -> bool:
    """Whether both images were taken by one camera: then its errors are the same in both."""
    return (
        camera1.size_wh == camera2.size_wh
        and np.array_equal(camera1.K, camera2.K)
        and np.array_equal(camera1.distortion, camera2.distortion)
    )
