"""Cameras and poses as kornia's PinholeCamera and Se3."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from kornia.geometry.liegroup import Se3
from made_up_scene import make_scene

from sfmkit.errors import InputError
from sfmkit.geometry import (
    camera_from_pinhole,
    pinhole_from_camera,
    pose_from_se3,
    project,
    se3_from_pose,
)
from sfmkit.types import Camera

S = make_scene()
D = torch.float64
CAMERA = Camera(S.K1.numpy(), (640, 480))
X = torch.rand(30, 3, dtype=D) + torch.tensor([0, 0, 4.0], dtype=D)


def test_a_pinhole_camera_projects_to_the_same_pixels():
    pinhole = pinhole_from_camera(CAMERA, S.R, S.t)
    assert pinhole.intrinsics.dtype == D
    assert pinhole.intrinsics.shape == (1, 4, 4)
    torch.testing.assert_close(pinhole.project(X[None])[0], project(X, S.K1, S.R, S.t))


def test_a_pinhole_camera_converts_back_to_camera_and_pose():
    camera, R, t = camera_from_pinhole(pinhole_from_camera(CAMERA, S.R, S.t))
    np.testing.assert_array_equal(camera.K, CAMERA.K)
    assert camera.size_wh == CAMERA.size_wh
    torch.testing.assert_close(R, S.R)
    torch.testing.assert_close(t, S.t)


def test_input_that_a_pinhole_camera_does_not_support_is_rejected():
    with pytest.raises(InputError, match="distortion"):
        pinhole_from_camera(Camera(S.K1.numpy(), (640, 480), np.array([0.1, 0, 0, 0, 0])))
    with pytest.raises(InputError, match="both"):
        pinhole_from_camera(CAMERA, S.R)
    one = pinhole_from_camera(CAMERA)
    parts = one.intrinsics, one.extrinsics, one.height, one.width
    two = type(one)(*(torch.cat((a, a)) for a in parts))
    with pytest.raises(InputError, match="batch of 2"):
        camera_from_pinhole(two)


def test_se3_acts_like_the_pose_and_converts_back():
    pose = se3_from_pose(S.R, S.t)
    assert isinstance(pose, Se3)
    torch.testing.assert_close((pose.matrix()[:3, :3] @ X.T).T + pose.t, X @ S.R.mT + S.t)
    R, t = pose_from_se3(pose)
    torch.testing.assert_close(R, S.R)
    torch.testing.assert_close(t, S.t)
    batch = se3_from_pose(S.R.expand(3, 3, 3), S.t.expand(3, 3))
    torch.testing.assert_close(
        pose_from_se3(batch * batch.inverse())[0], torch.eye(3, dtype=D).expand(3, 3, 3)
    )


def test_se3_is_differentiable():
    R, t = S.R.clone().requires_grad_(), S.t.clone().requires_grad_()
    back, moved = pose_from_se3(se3_from_pose(R, t))
    (back.sum() + moved.sum()).backward()
    torch.testing.assert_close(t.grad, torch.ones(3, dtype=D))
    assert R.grad.isfinite().all()


def test_se3_rejects_two_batch_dimensions():
    with pytest.raises(InputError, match="shapes"):
        se3_from_pose(S.R.expand(2, 2, 3, 3), S.t.expand(2, 2, 3))
