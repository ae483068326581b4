"""Plain arrays of what recordings draw: samples, outlines, ellipsoids, colour values."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from ..geometry.distortion import undistort_pixels
from ..types import Camera, PointCloud
from ..viz.sampling import spread, spread_strongest

__all__ = [
    "ellipsoids",
    "example_point",
    "ideal_image",
    "ideal_pixels",
    "largest_sigma",
    "neighbour_density",
    "orientation_ticks",
    "spread",
    "spread_strongest",
    "warped_outline",
]


def ideal_pixels(x: np.ndarray | Tensor, camera: Camera | None) -> np.ndarray:
    """Pixels (N, 2) as a pinhole camera with the same K sees them: without distortion, float64.

    A pixel outside the field of the lens has no place there: it is moved to the border of the
    field, towards the principal point.
    """
    t = torch.as_tensor(np.asarray(x), dtype=torch.float64)
    if camera is None:
        return t.numpy()
    ideal, valid = undistort_pixels(t, camera, return_valid=True)
    if not bool(valid.all()):
        centre = camera.tensors()[0][:2, 2]
        outside = t[~valid] - centre
        place, share, step = centre.expand_as(outside), torch.zeros_like(outside[:, :1]), 0.5
        for _ in range(20):  # bisection; the principal point stays where it is
            tried = centre + (share + step) * outside
            found, within = undistort_pixels(tried, camera, return_valid=True)
            place = torch.where(within[:, None], found, place)
            share = share + step * within[:, None]
            step /= 2
        ideal[~valid] = place
    return ideal.numpy()


def ideal_image(rgb: np.ndarray, camera: Camera) -> np.ndarray:
    """Undistort a photograph, keeping K; returned unchanged where there is no distortion."""
    if not camera.has_distortion:
        return rgb
    if camera.model == "fisheye":
        return cv2.fisheye.undistortImage(rgb, camera.K, camera.distortion, Knew=camera.K)
    return cv2.undistort(rgb, camera.K, camera.distortion)


def orientation_ticks(keypoints: np.ndarray, scales: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Segments (N, 2, 2) from the centre to the rim of the neighbourhood, along the orientation."""
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (scales / 2)[:, None]
    return np.stack([keypoints, keypoints + rim], axis=1)


def warped_outline(H: np.ndarray, size_wh: tuple[int, int], steps: int = 32) -> np.ndarray | None:
    """Warp an image's border by H: (4 steps + 1, 2); None if it crosses the line at infinity."""
    w, h = size_wh
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
    border = np.concatenate(
        [np.linspace(a, b, steps, endpoint=False) for a, b in zip(corners, np.roll(corners, -1, 0))]
    )
    border = np.concatenate([border, border[:1]])
    y = np.c_[border, np.ones(len(border))] @ H.T
    if np.sign(y[:, 2]).min() != np.sign(y[:, 2]).max() or not y[:, 2].all():
        return None
    return y[:, :2] / y[:, 2:]


def ellipsoids(covariance: np.ndarray, sigmas: float) -> tuple[np.ndarray, np.ndarray]:
    """Half axes (N, 3) and quaternions xyzw (N, 4) of the ellipsoids of covariances (N, 3, 3).

    Args:
        sigmas: size of the ellipsoids in standard deviations.
    """
    values, vectors = np.linalg.eigh(covariance)
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1
    return sigmas * np.sqrt(np.maximum(values, 0)), Rotation.from_matrix(vectors).as_quat()


def largest_sigma(covariance: np.ndarray) -> np.ndarray:
    """Standard deviation (N,) along the worst direction of covariances (N, 3, 3)."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0))


def neighbour_density(xyz: np.ndarray, neighbours: int = 8) -> np.ndarray:
    """Points per cubic unit (M,) in the ball around each point that reaches its k-th neighbour."""
    if len(xyz) < 2:
        return np.zeros(len(xyz))
    k = min(neighbours, len(xyz) - 1)
    radius = np.maximum(cKDTree(xyz).query(xyz, k + 1)[0][:, k], 1e-9)
    return k / (4 / 3 * np.pi * radius**3)


def example_point(cloud: PointCloud) -> int:
    """Row of a point with many operators, typical parallax and a small residual."""
    mask = cloud.operator_mask.numpy()
    operators = sum((mask >> k & 1) for k in range(len(cloud.operators)))
    parallax = cloud.parallax.numpy()
    typical = np.abs(parallax - np.median(parallax)) <= np.percentile(
        np.abs(parallax - np.median(parallax)), 50
    )
    return int(np.lexsort((cloud.reprojection_error.numpy(), ~typical, -operators))[0])
