"""Lens distortion against OpenCV, and its inverse against itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.distortion import distort, undistort

D = torch.float64
LENS = torch.tensor([-0.28, 0.07, 1e-3, -5e-4, 0.01], dtype=D)


def points(n: int = 200, extent: float = 0.7) -> torch.Tensor:
    return (torch.rand(n, 2, generator=torch.Generator().manual_seed(0), dtype=D) * 2 - 1) * extent


def test_distortion_is_opencvs():
    x = points()
    rays = np.c_[x.numpy(), np.ones(200)]
    theirs, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), LENS.numpy())
    np.testing.assert_allclose(distort(x, LENS).numpy(), theirs[:, 0], atol=1e-15)


def test_inverse_is_exact_and_opencvs():
    x = points()
    y = distort(x, LENS)
    torch.testing.assert_close(undistort(y, LENS), x, rtol=0, atol=1e-15)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    theirs = cv2.undistortPoints(y.numpy()[:, None], np.eye(3), LENS.numpy(), criteria=criteria)
    np.testing.assert_allclose(undistort(y, LENS).numpy(), theirs[:, 0], atol=1e-9)
    torch.testing.assert_close(undistort(y.float(), LENS.float()), x.float(), rtol=0, atol=3e-7)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.05, 0.1),
    st.floats(-2e-3, 2e-3),
    st.floats(-2e-3, 2e-3),
    st.floats(0.0, 0.02),
)
def test_inverse_of_any_moderate_lens(k1, k2, p1, p2, k3):
    d = torch.tensor([k1, k2, p1, p2, k3], dtype=D)
    x = points(20, extent=0.55)
    torch.testing.assert_close(undistort(distort(x, d), d), x, rtol=0, atol=1e-13)


def test_no_distortion_changes_nothing():
    assert torch.equal(undistort(points(), 0 * LENS), points())


def test_points_that_no_ray_reaches():
    barrel = torch.tensor([-0.3, 0.0, 0.0, 0.0, 0.0], dtype=D)  # the image ends at radius 0.70
    with pytest.raises(InputError, match="1 of 2 points"):
        undistort(torch.tensor([[0.1, 0.1], [0.6, 0.6]], dtype=D), barrel)
    with pytest.raises(
        InputError, match="k1"
    ):  # Newton would find a root on the far side of the fold
        undistort(torch.tensor([[-1.5, 0.0]], dtype=D), barrel)


def test_a_batch_is_its_items():
    y = distort(points(), LENS).reshape(4, 50, 2)
    lenses = torch.stack([s * LENS for s in (0.0, 0.5, 1.0, 1.1)])
    together = undistort(y, lenses)
    torch.testing.assert_close(
        together, torch.stack([undistort(a, d) for a, d in zip(y, lenses)]), rtol=1e-15, atol=0
    )
    torch.testing.assert_close(torch.func.vmap(undistort)(y, lenses), together, rtol=1e-14, atol=0)


@pytest.mark.grad
@pytest.mark.parametrize("function", [distort, undistort])
def test_derivatives(function):
    args = (points(3).requires_grad_(), LENS.clone().requires_grad_())
    assert gradcheck(function, args)
    assert gradgradcheck(function, args)
    J = torch.func.jacrev(function, argnums=1)(*args)
    assert J.isfinite().all()


def test_bad_input_is_named():
    with pytest.raises(InputError, match="d "):
        undistort(points(), LENS[:4])
    with pytest.raises(InputError, match="NaN"):
        distort(points() * torch.nan, LENS)
