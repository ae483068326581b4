"""The eye of the 3-D views: where it stands, and what it must see."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..geometry.essential import decompose_essential
from ..types import Camera
from .log_geometry import label_height

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

UP = (0, -1, 0)  # the frame of camera 1 has y down
# Direction of view into the scene, from behind, above and the left of the cameras.
_FORWARD = np.array([-0.35, 0.42, 0.84])
_FIELD = np.tan(np.radians(55 / 2))  # half the viewer's vertical field of view
_ASPECT = 1.25  # width over height of the narrowest 3-D view at 1280 x 800


def eye_for(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place the eye so that all points (M, 3) are inside the view.

    Returns:
        position and target (3,) of the eye.
    """
    forward = _FORWARD / np.linalg.norm(_FORWARD)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    local = points @ np.stack([right, up, forward], axis=1)
    middle = (local.min(0) + local.max(0)) / 2
    x, y, z = (local - middle).T
    distance = max((np.abs(x) / (_FIELD * _ASPECT) - z).max(), (np.abs(y) / _FIELD - z).max())
    target = np.stack([right, up, forward], axis=1) @ middle
    return target - 1.1 * distance * forward, target


def seen_points(result: Reconstruction) -> np.ndarray:
    """Points that the 3-D views must contain: both cameras as drawn, and the middle of the cloud.

    The outermost 3 % of the cloud in each direction may lie outside.
    """
    view, cloud = result.two_view, result.cloud
    size = frustum_size(result)
    inside = [_frustum(view.camera1, size)]
    if view.R is None:
        inside.append(_frustum(view.camera2, size))
    else:
        t = np.zeros(3) if view.t is None else view.t.numpy()
        inside.append((_frustum(view.camera2, size) - t) @ view.R.numpy())
    if cloud is not None and len(cloud):
        low, high = np.percentile(cloud.xyz.numpy(), (3, 97), axis=0)
        xyz = cloud.xyz.numpy()
        inside.append(xyz[((xyz >= low) & (xyz <= high)).all(1)])
    return np.concatenate(inside)


def near_points(result: Reconstruction) -> np.ndarray | None:
    """Camera 1, the cameras of the four poses that E permits, and their labels."""
    view = result.two_view
    if view.E is None or view.R is None:
        return None
    size = frustum_size(result)
    inside = [_frustum(view.camera1, size)]
    for number, (R, t) in enumerate(zip(*decompose_essential(view.E)), start=1):
        camera = (_frustum(view.camera2, size) - t.numpy()) @ R.numpy()
        label = camera[:1] - [[0, label_height(number, size), 0]]
        inside += [camera, label + [[-size, 0, 0]], label + [[size, 0, 0]]]
    return np.concatenate(inside)


def frustum_size(result: Reconstruction) -> float:
    """Distance of the drawn image planes from their cameras, baselines: a share of the depth."""
    cloud = result.cloud
    return 0.15 * (float(cloud.xyz[:, 2].median()) if cloud is not None and len(cloud) else 4.0)


def _frustum(camera: Camera, size: float) -> np.ndarray:
    """(5, 3) the centre of a camera and the corners of its image plane, in its own frame."""
    w, h = camera.size_wh
    corners = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1.0]])
    return np.concatenate([np.zeros((1, 3)), size * corners @ np.linalg.inv(camera.K).T])
