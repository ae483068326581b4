"""Projection and reprojection errors against OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from made_up_scene import make_scene
from torch.autograd import gradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.coordinates import normalize
from sfmkit.geometry.lie import so3_log
from sfmkit.geometry.reprojection import project, reprojection_error, reprojection_residuals
from sfmkit.geometry.triangulation import triangulate_optimal

D = torch.float64
LENS = torch.tensor([-0.2, 0.05, 1e-3, -5e-4, 0.01], dtype=D)


def world(n: int = 40):
    s = make_scene(n)
    return s, triangulate_optimal(normalize(s.x1, s.K1), normalize(s.x2, s.K2), s.R, s.t)


@pytest.mark.parametrize("lens", [None, LENS])
def test_projection_agrees_with_opencv(lens):
    s, X = world()
    K = s.K1  # OpenCV does not support skew
    d = None if lens is None else lens.numpy()
    theirs, _ = cv2.projectPoints(X.numpy(), so3_log(s.R).numpy(), s.t.numpy(), K.numpy(), d)
    np.testing.assert_allclose(project(X, K, s.R, s.t, lens).numpy(), theirs[:, 0], atol=1e-10)


def test_homogeneous_points_may_lie_at_infinity():
    s, X = world()
    H = torch.cat((X, torch.ones(40, 1, dtype=D)), 1) * -3
    torch.testing.assert_close(project(H, s.K2, s.R, s.t), project(X, s.K2, s.R, s.t))
    far = torch.tensor([[0.1, 0.2, 1.0, 0.0]], dtype=D)
    torch.testing.assert_close(project(far, s.K2, s.R, s.t), project(far[:, :3], s.K2, s.R))


def test_residuals_and_their_root_mean_square():
    s, X = world()
    shift = torch.tensor([3.0, 0.0], dtype=D), torch.tensor([0.0, -4.0], dtype=D)
    args = (X, s.x1 + shift[0], s.x2 + shift[1], s.K1, s.K2, s.R, s.t)
    torch.testing.assert_close(
        reprojection_residuals(*args), torch.tensor([-3.0, 0, 0, 4], dtype=D).expand(40, 4)
    )
    torch.testing.assert_close(reprojection_error(*args), torch.full((40,), 12.5**0.5, dtype=D))


def test_batch_and_float32():
    s, X = world()
    args = (X, s.x1 + 0.3, s.x2, s.K1, s.K2, s.R, s.t, LENS, LENS)
    one = reprojection_error(*args)
    both = reprojection_error(*(torch.stack((a, a)) for a in args))
    torch.testing.assert_close(both, torch.stack((one, one)), rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(
        reprojection_error(*(a.float() for a in args)), one.float(), rtol=0, atol=1e-3
    )


@pytest.mark.grad
def test_derivatives():
    s, X = world(3)
    args = [a.clone().requires_grad_() for a in (X, s.x1 + 1, s.x2, s.R, s.t, LENS, LENS)]

    def error(X, x1, x2, R, t, d1, d2):
        return reprojection_error(X, x1, x2, s.K1, s.K2, R, t, d1, d2)

    assert gradcheck(error, args)
    exact = args[0].detach().requires_grad_()
    reprojection_error(
        exact, project(exact, s.K1).detach(), s.x2, s.K1, s.K2, s.R, s.t
    ).sum().backward()
    assert exact.grad.isfinite().all()


def test_bad_input_is_named():
    s, X = world()
    with pytest.raises(InputError, match="X"):
        project(X[:, :2], s.K1)
    with pytest.raises(InputError, match="singular"):
        project(X, 0 * s.K1)
