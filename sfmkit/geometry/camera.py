"""Conversion of :class:`sfmkit.types.Camera` to and from kornia's ``PinholeCamera``."""

from __future__ import annotations

import numpy as np
import torch
from kornia.geometry.camera import PinholeCamera
from torch import Tensor

from ..errors import InputError
from ..types import Camera
from .checks import check_matrices


def pinhole_from_camera(
    camera: Camera, R: Tensor | None = None, t: Tensor | None = None
) -> PinholeCamera:
    """Convert the camera to a kornia ``PinholeCamera``, float64, with a batch of one.

    In both types, the centre of the top-left pixel is (0, 0).

    Args:
        camera: Camera without lens distortion, which PinholeCamera does not support. Undistort the
            pixels first (:func:`sfmkit.geometry.distortion.undistort_pixels`).
        R, t: (3, 3) and (3,) pose ``X_camera = R X_world + t``; the identity by default.

    Raises:
        InputError: The camera has distortion, or only one of R and t is given.
    """
    if camera.has_distortion:
        raise InputError(
            "kornia's PinholeCamera has no lens distortion; undistort the pixels first"
        )
    if (R is None) != (t is None):
        raise InputError("give both R and t, or neither")
    M = torch.eye(4, dtype=torch.float64)[None]
    if R is not None and t is not None:
        check_matrices(shape=(3, 3), R=R)
        check_matrices(R, shape=(3,), t=t)
        if R.ndim != 2 or t.ndim != 1:
            raise InputError(
                "R and t must have shapes (3, 3) and (3,), "
                f"not {tuple(R.shape)} and {tuple(t.shape)}"
            )
        rows = torch.cat((R.double(), t.double()[:, None]), -1)
        M = torch.cat((rows, M[0, 3:]))[None]
    intrinsics = torch.eye(4, dtype=torch.float64)[None].clone()
    intrinsics[0, :3, :3] = torch.tensor(camera.K)
    w, h = (torch.tensor([float(v)], dtype=torch.float64) for v in camera.size_wh)
    return PinholeCamera(intrinsics, M, h, w)


def camera_from_pinhole(pinhole: PinholeCamera) -> tuple[Camera, Tensor, Tensor]:
    """Convert a kornia ``PinholeCamera`` to a camera and a pose R (3, 3), t (3,).

    Raises:
        InputError: The batch contains more than one camera.
        CameraError: No camera has these intrinsics.
    """
    if pinhole.intrinsics.shape[0] != 1:
        raise InputError(
            f"expected one camera, not a batch of {pinhole.intrinsics.shape[0]}; convert each one"
        )
    K = pinhole.intrinsics[0, :3, :3].detach().cpu().double().numpy()
    w, h = (int(torch.round(v.flatten()[0])) for v in (pinhole.width, pinhole.height))
    M = pinhole.extrinsics[0]
    return Camera(np.array(K), (w, h)), M[:3, :3], M[:3, 3]
