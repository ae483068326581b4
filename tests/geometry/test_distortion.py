"""Lens distortion compared with OpenCV and kornia, and its inverse with itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from kornia.geometry.calibration import undistort_points
from torch.autograd import gradcheck, gradgradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.distortion import distort, distort_pixels, undistort, undistort_pixels
from sfmkit.types import Camera

D = torch.float64
# k1 k2 p1 p2 k3 | k4 k5 k6 | s1 s2 s3 s4 | tx ty: a wide-angle lens with every term of OpenCV.
FULL = torch.tensor(
    [-0.28, 0.07, 1e-3, -5e-4, 0.01, 0.05, -0.02, 3e-3, 1e-3, -2e-3, 2e-3, 1e-3, 0.02, -0.03],
    dtype=D,
)
LENS = FULL[:5]
FISHEYE = torch.tensor([0.1, -0.02, 0.003, -0.001], dtype=D)
LENSES = {
    **{f"opencv {n}": (FULL[:n], "opencv") for n in (4, 5, 8, 12, 14)},
    "fisheye": (FISHEYE, "fisheye"),
}
lenses = pytest.mark.parametrize(("d", "model"), LENSES.values(), ids=LENSES)


def points(n: int = 200, extent: float = 0.7) -> torch.Tensor:
    return (torch.rand(n, 2, generator=torch.Generator().manual_seed(0), dtype=D) * 2 - 1) * extent


def opencv_distort(x: torch.Tensor, d: torch.Tensor, model: str) -> np.ndarray:
    if model == "fisheye":
        return cv2.fisheye.distortPoints(x.numpy()[:, None], np.eye(3), d.numpy())[:, 0]
    rays = np.c_[x.numpy(), np.ones(len(x))]
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), d.numpy())[0][:, 0]


@lenses
def test_distortion_agrees_with_opencv(d, model):
    np.testing.assert_allclose(
        distort(points(), d, model).numpy(), opencv_distort(points(), d, model), atol=1e-14
    )


@lenses
def test_the_inverse_is_exact(d, model):
    x = points(extent=3.0 if model == "fisheye" else 0.7)
    y = distort(x, d, model)
    torch.testing.assert_close(undistort(y, d, model), x, rtol=0, atol=1e-13)
    low = undistort(y.float(), d.float(), model)
    assert low.dtype == torch.float32
    torch.testing.assert_close(low, x.float(), rtol=2e-6, atol=2e-6)


@lenses
def test_the_inverse_agrees_with_opencv(d, model):
    y = distort(points(), d, model)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    if model == "fisheye":
        theirs = cv2.fisheye.undistortPoints(y.numpy()[:, None], np.eye(3), d.numpy())
    else:
        theirs = cv2.undistortPoints(y.numpy()[:, None], np.eye(3), d.numpy(), criteria=criteria)
    np.testing.assert_allclose(undistort(y, d, model).numpy(), theirs[:, 0], atol=1e-8)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.05, 0.1),
    st.floats(-2e-3, 2e-3),
    st.floats(-2e-3, 2e-3),
    st.floats(0.0, 0.02),
)
def test_the_inverse_of_random_moderate_lenses(k1, k2, p1, p2, k3):
    d = torch.tensor([k1, k2, p1, p2, k3], dtype=D)
    x = points(20, extent=0.55)
    torch.testing.assert_close(undistort(distort(x, d), d), x, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("k1", "reach"), [(-0.35, 0.97), (0.5, 2.0)])
def test_the_inverse_is_correct_where_fixed_point_iteration_is_wrong(k1, reach):
    """Test the reason why kornia's inverse is not used (kornia 0.9, OpenCV 5)."""
    d = torch.tensor([k1, 0, 0, 0, 0], dtype=D)
    r = torch.linspace(0, reach, 500, dtype=D)
    x = torch.stack((r, torch.zeros_like(r)), -1)
    y = distort(x, d)
    torch.testing.assert_close(undistort(y, d), x, rtol=0, atol=1e-12)
    kornia = undistort_points(y, torch.eye(3, dtype=D), d)
    opencv = cv2.undistortPoints(y.numpy()[:, None], np.eye(3), d.numpy())[:, 0]
    for theirs in (kornia, torch.from_numpy(opencv)):
        assert ((theirs - x).abs().amax(-1) > 1e-6).double().mean() > 0.5


def test_no_distortion_changes_nothing():
    torch.testing.assert_close(undistort(points(), 0 * LENS), points(), rtol=0, atol=1e-16)
    assert undistort(points()[:0], LENS).shape == (0, 2)


BARREL = torch.tensor([-0.3, 0.0, 0.0, 0.0, 0.0], dtype=D)  # the image ends at radius 0.70


def test_points_outside_the_field_are_rejected_or_masked():
    y = torch.tensor([[0.1, 0.1], [0.6, 0.6], [-1.5, 0.0]], dtype=D)
    with pytest.raises(InputError, match="2 of 3 points"):
        undistort(y, BARREL)
    # The cubic has a root for the third point too, on the far side of the fold.
    x, valid = undistort(y, BARREL, return_valid=True)
    assert valid.tolist() == [True, False, False]
    torch.testing.assert_close(distort(x[:1], BARREL), y[:1])
    assert x[1:].isnan().all()


@pytest.mark.parametrize(
    ("d", "model", "end"),
    [
        (BARREL, "opencv", (2 / 3) * (1 / 0.9) ** 0.5),
        # (1 + s) / (1 + 2 s) never folds; 1 / (1 - s) has its pole at r = 1, where the image is
        # infinite; r / (1 + s) folds at r = 1 with image 1 / 2.
        (torch.tensor([0, 0, 0, 0, 0, 1.0, 0, 0], dtype=D), "opencv", 0.5),
        # theta (1 - s / 3) folds at theta = 1 with image 2 / 3.
        (torch.tensor([-1 / 3, 0, 0, 0], dtype=D), "fisheye", 2 / 3),
        # No fold: the image ends at 90 degrees.
        (torch.zeros(4, dtype=D), "fisheye", np.pi / 2),
    ],
)
def test_the_field_ends_where_the_radial_map_folds(d, model, end):
    y = torch.tensor([[end - 1e-6, 0.0], [end + 1e-6, 0.0]], dtype=D)
    x, valid = undistort(y, d, model, return_valid=True)
    assert valid.tolist() == [True, False]
    torch.testing.assert_close(distort(x[:1], d, model), y[:1])


@pytest.mark.grad
def test_masked_points_leave_the_derivatives_of_the_others_finite():
    y = torch.tensor([[0.1, 0.1], [0.6, 0.6]], dtype=D, requires_grad=True)
    d = BARREL.clone().requires_grad_()
    x, valid = undistort(y, d, return_valid=True)
    grads = torch.autograd.grad(x[valid].sum(), (y, d))
    assert all(g.isfinite().all() for g in grads)


def test_a_batch_agrees_with_its_items():
    y = distort(points(), LENS).reshape(4, 50, 2)
    several = torch.stack([s * LENS for s in (0.0, 0.5, 1.0, 1.1)])
    together = undistort(y, several)
    single = torch.stack([undistort(a, d) for a, d in zip(y, several)])
    torch.testing.assert_close(together, single, rtol=0, atol=1e-13)
    mapped = torch.func.vmap(undistort)(y, several)
    torch.testing.assert_close(mapped, together, rtol=0, atol=1e-13)


@pytest.mark.grad
@pytest.mark.parametrize("function", [distort, undistort])
@lenses
def test_derivatives(function, d, model):
    args = (points(3).requires_grad_(), d.clone().requires_grad_())
    assert gradcheck(lambda x, d: function(x, d, model), args)
    assert gradgradcheck(lambda x, d: function(x, d, model), args)
    J = torch.func.jacrev(lambda x, d: function(x, d, model), argnums=1)(*args)
    assert J.isfinite().all()


@pytest.mark.grad
@pytest.mark.parametrize("function", [distort, undistort])
def test_derivatives_on_the_optical_axis_of_a_fisheye(function):
    origin = torch.zeros(1, 2, dtype=D)
    J = torch.func.jacrev(lambda x: function(x, FISHEYE, "fisheye"))(origin)
    torch.testing.assert_close(J[0, :, 0], torch.eye(2, dtype=D))


def test_pixels_of_a_camera():
    K = np.array([[500.0, 0.5, 320.0], [0, 510, 240], [0, 0, 1]])
    x = torch.tensor([[320.0, 240.0], [10.0, 20.0], [600.0, 400.0]], dtype=D)
    for d, model in LENSES.values():
        camera = Camera(K, (640, 480), d[:4] if model == "fisheye" else d.numpy(), model=model)
        ideal, valid = undistort_pixels(x, camera, return_valid=True)
        assert valid.all()
        torch.testing.assert_close(distort_pixels(ideal, camera), x, rtol=0, atol=1e-9)
        torch.testing.assert_close(undistort_pixels(x, camera), ideal)
    assert undistort_pixels(x, Camera(K, (640, 480))) is x


def test_bad_input_is_named():
    with pytest.raises(InputError, match="d must have 4, 5, 8, 12, 14"):
        undistort(points(), LENS[:3])
    with pytest.raises(InputError, match="4 coefficients for the model fisheye"):
        distort(points(), LENS, "fisheye")
    with pytest.raises(InputError, match="'opencv' or 'fisheye'"):
        distort(points(), LENS, "division")
    with pytest.raises(InputError, match="NaN"):
        distort(points() * torch.nan, LENS)
