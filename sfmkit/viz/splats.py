"""Rendering of clouds as small discs with occlusion."""

from __future__ import annotations

import numpy as np

from ..types import Camera, PointCloud


def splat(
    cloud: PointCloud,
    camera: Camera,
    *,
    width: int = 900,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    dot: int = 3,
    background: int = 255,
) -> np.ndarray:
    """Render a cloud from camera 1, or from a viewpoint turned about the centre of the cloud.

    Args:
        cloud: M points in the frame of camera 1.
        camera: Camera of image 1; the picture has its field of view.
        width: Width of the picture, pixels.
        yaw_deg, pitch_deg: Angles of the viewpoint to the right of and above camera 1, degrees.
        dot: Diameter of a point, pixels.
        background: Grey level of the background.

    Returns:
        (H, W, 3) uint8.
    """
    scale = width / camera.size_wh[0]
    w, h = width, round(camera.size_wh[1] * scale)
    picture = np.full((h, w, 3), background, np.uint8)
    if not len(cloud):
        return picture
    X = cloud.xyz.numpy()
    middle = np.median(X, axis=0)
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array(
        [[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]]
    )
    Y = (X - middle) @ (tilt @ turn).T + middle
    K = camera.scaled((w, h)).K
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (Y @ K.T)[:, :2] / Y[:, 2:]
    inside = (Y[:, 2] > 0) & ((x > -0.5) & (x < (w - 0.5, h - 0.5))).all(1)
    far_first = np.flatnonzero(inside)[np.argsort(-Y[inside, 2], kind="stable")]
    disc = np.mgrid[:dot, :dot].reshape(2, -1).T - (dot - 1) / 2
    disc = np.floor(disc[(disc**2).sum(1) <= dot**2 / 4 + 0.01]).astype(np.int64)
    at = np.rint(x[far_first, ::-1]).astype(np.int64)[:, None] + disc
    row, column = np.clip(at, 0, (h - 1, w - 1)).reshape(-1, 2).T
    # If several points are projected onto one pixel, the nearest one is written last.
    picture[row, column] = np.repeat(cloud.rgb.numpy()[far_first], len(disc), axis=0)
    return picture
