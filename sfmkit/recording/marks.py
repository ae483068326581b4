"""What recordings draw, as plain arrays: samples, lines, outlines, ellipsoids. Nothing here knows a
viewer."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from ..geometry.coordinates import denormalize, normalize
from ..geometry.distortion import undistort
from ..types import Camera, Features, PointCloud


def ideal_pixels(x: np.ndarray | Tensor, camera: Camera) -> np.ndarray:
    """(N, 2) float64 pixels where a pinhole with the same K, without distortion, would have seen
    the pixels x."""
    t = torch.as_tensor(np.asarray(x), dtype=torch.float64)
    K, d = camera.tensors()
    return (t if d is None or not len(t) else denormalize(undistort(normalize(t, K), d), K)).numpy()


def ideal_image(rgb: np.ndarray, camera: Camera) -> np.ndarray:
    """The photograph as a pinhole with the same K would have taken it; itself where there is no
    distortion."""
    return cv2.undistort(rgb, camera.K, camera.distortion) if camera.has_distortion else rgb


def spread(x: np.ndarray, n: int) -> np.ndarray:
    """Rows of at most n points of (N, 2) that lie evenly over the image: in a grid's cells, the
    first of each in turn.

    Of points that come best first, the best of every cell are taken before any second best.
    """
    if len(x) <= n:
        return np.arange(len(x))
    cells = max(2, round(np.sqrt(n)))
    low, high = x.min(0), x.max(0)
    cell = np.minimum(((x - low) / np.maximum(high - low, 1e-9) * cells).astype(int), cells - 1)
    key = cell[:, 0] * cells + cell[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.concatenate(([True], np.diff(key[order]) > 0))
    rank = np.arange(len(x)) - np.maximum.accumulate(np.where(starts, np.arange(len(x)), 0))
    return order[np.argsort(rank, kind="stable")][:n]


def strongest(features: Features, n: int) -> np.ndarray:
    """Rows of n strong keypoints spread evenly over the image."""
    order = np.argsort(-features.scores, kind="stable")
    return order[spread(features.keypoints[order], n)]


def orientation_ticks(keypoints: np.ndarray, scales: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(N, 2, 2) segments from the centre to the rim of the described neighbourhood, along the
    orientation."""
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (scales / 2)[:, None]
    return np.stack([keypoints, keypoints + rim], axis=1)


def clip_lines(lines: np.ndarray, size_wh: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The part of each line ``a u + b v + c = 0`` inside the image.

    Args:
        lines: (N, 3).

    Returns:
        segments (M, 2, 2) pixels on the border, and rows (M,) of the lines that cross the image.
    """
    w, h = size_wh
    low, high = np.array([-0.5, -0.5]), np.array([w - 0.5, h - 0.5])
    ends, rows = [], []
    for row, (a, b, c) in enumerate(np.asarray(lines, dtype=np.float64)):
        norm = np.hypot(a, b)
        if not norm > 0:
            continue
        base, along = np.array([-a, -b]) * c / norm**2, np.array([b, -a]) / norm
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.stack([(low - base) / along, (high - base) / along])
        free = along == 0  # parallel to a side: inside it or nowhere
        if np.any(free & ((base < low) | (base > high))):
            continue
        enter = np.max(np.where(free, -np.inf, s.min(0)))
        leave = np.min(np.where(free, np.inf, s.max(0)))
        if enter < leave:
            ends.append((base + enter * along, base + leave * along))
            rows.append(row)
    return np.array(ends).reshape(-1, 2, 2), np.array(rows, dtype=np.int64)


def warped_outline(H: np.ndarray, size_wh: tuple[int, int], steps: int = 32) -> np.ndarray | None:
    """(4 steps + 1, 2) the image's border after the homography H; None where part of it goes beyond
    infinity."""
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
    """Half axes (N, 3) and orientations as quaternions xyzw (N, 4) of the `sigmas`-sigma ellipsoids
    of (N, 3, 3)."""
    values, vectors = np.linalg.eigh(covariance)
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1
    return sigmas * np.sqrt(np.maximum(values, 0)), Rotation.from_matrix(vectors).as_quat()


def largest_sigma(covariance: np.ndarray) -> np.ndarray:
    """(N,) standard deviation along the worst direction of (N, 3, 3) covariances."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0))


def neighbour_density(xyz: np.ndarray, neighbours: int = 8) -> np.ndarray:
    """(M,) points per cubic unit in the ball that reaches to the given neighbour of each of (M, 3)
    points."""
    if len(xyz) < 2:
        return np.zeros(len(xyz))
    k = min(neighbours, len(xyz) - 1)
    radius = np.maximum(cKDTree(xyz).query(xyz, k + 1)[0][:, k], 1e-9)
    return k / (4 / 3 * np.pi * radius**3)


def telling_point(cloud: PointCloud) -> int:
    """Row of a point to show as an example: of many operators, typical parallax, small residual."""
    mask = cloud.operator_mask.numpy()
    operators = sum((mask >> k & 1) for k in range(len(cloud.operators)))
    parallax = cloud.parallax.numpy()
    typical = np.abs(parallax - np.median(parallax)) <= np.percentile(
        np.abs(parallax - np.median(parallax)), 50
    )
    return int(np.lexsort((cloud.reprojection_error.numpy(), ~typical, -operators))[0])
