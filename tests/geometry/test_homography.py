"""Homographies against known planes and OpenCV."""

from __future__ import annotations

import cv2
import pytest
import torch
from made_up_scene import make_scene
from torch.autograd import gradcheck

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.homography import (
    decompose_homography,
    homography_4point,
    homography_dlt,
    homography_from_pose,
    squared_homography_sampson_distance,
    squared_symmetric_transfer_error,
    squared_transfer_error,
    transfer,
)
from sfmkit.geometry.kernels import unit_norm

PLANE = make_scene(60, planar=True)
H = homography_from_pose(PLANE.R, PLANE.t, PLANE.normal, PLANE.distance, PLANE.K1, PLANE.K2)
NOISY = make_scene(60, noise=0.5, planar=True)


def test_plane_and_pose_give_the_homography_of_the_points():
    assert torch.allclose(transfer(H, PLANE.x1), PLANE.x2, rtol=0, atol=1e-10)
    assert float(squared_symmetric_transfer_error(H, PLANE.x1, PLANE.x2).max()) < 1e-20


@pytest.mark.parametrize("solve", [homography_dlt, lambda a, b: homography_4point(a[:4], b[:4])])
def test_solvers_recover_an_exact_homography(solve):
    assert float((solve(PLANE.x1, PLANE.x2) - unit_norm(H)).abs().max()) < 1e-12


def test_dlt_agrees_with_opencv_on_noise():
    ours = homography_dlt(NOISY.x1, NOISY.x2)
    theirs, _ = cv2.findHomography(
        NOISY.x1.numpy(), NOISY.x2.numpy(), 0
    )  # OpenCV ends with a nonlinear refinement
    apart = transfer(ours, NOISY.x1) - transfer(torch.from_numpy(theirs), NOISY.x1)
    assert float(apart.norm(dim=-1).max()) < 0.1


def test_a_weight_of_zero_excludes_a_match():
    x2 = PLANE.x2.clone()
    x2[:5] += 100
    w = torch.ones(60, dtype=torch.float64)
    w[:5] = 0
    assert float((homography_dlt(PLANE.x1, x2, w) - unit_norm(H)).abs().max()) < 1e-12


def test_sampson_distance_of_a_translation_is_half_the_squared_displacement():
    shift = torch.tensor([[1.0, 0, 5], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    x = torch.tensor([[10.0, 20.0]], dtype=torch.float64)
    moved = x + torch.tensor([5.0, 3.0], dtype=torch.float64)  # 3 px, distributed over both images
    assert squared_homography_sampson_distance(shift, x, moved).item() == pytest.approx(4.5)
    assert squared_transfer_error(shift, x, moved).item() == pytest.approx(9.0)


def test_the_decomposition_contains_the_true_pose_and_plane_and_agrees_with_opencv():
    R, t, n = decompose_homography(-7 * H, PLANE.K1, PLANE.K2)
    error = (
        (R - PLANE.R).flatten(1).norm(dim=1)
        + (t - PLANE.t / PLANE.distance).norm(dim=1)
        + (n - PLANE.normal).norm(dim=1)
    )
    assert float(error.min()) < 1e-12
    assert torch.allclose(R @ R.mT, torch.eye(3).double().expand(4, 3, 3), atol=1e-13)
    whole = torch.linalg.inv(PLANE.K2) @ H @ PLANE.K1
    _, Rs, ts, ns = cv2.decomposeHomographyMat(whole.numpy(), torch.eye(3).double().numpy())
    for R_cv, t_cv, n_cv in zip(Rs, ts, ns):
        gap = [
            float(
                (torch.from_numpy(R_cv) - a).norm()
                + (torch.from_numpy(t_cv[:, 0]) - b).norm()
                + (torch.from_numpy(n_cv[:, 0]) - c).norm()
            )
            for a, b, c in zip(R, t, n)
        ]
        assert min(gap) < 1e-8


def test_decomposition_of_a_pure_rotation_has_no_translation_and_finite_derivatives():
    rotation = (PLANE.K2 @ PLANE.R @ torch.linalg.inv(PLANE.K1)).requires_grad_()
    R, t, n = decompose_homography(rotation, PLANE.K1, PLANE.K2)
    assert float((R - PLANE.R).detach().abs().max()) < 1e-7
    assert float(t.detach().abs().max()) < 1e-7
    (R.sum() + t.sum() + n.sum()).backward()
    assert torch.isfinite(rotation.grad).all()


def test_batch_equals_singles_and_float32_is_close():
    a = torch.stack((PLANE.x1, NOISY.x1))
    b = torch.stack((PLANE.x2, NOISY.x2))
    both = homography_dlt(a, b)
    for i in range(2):
        assert torch.allclose(both[i], homography_dlt(a[i], b[i]), rtol=0, atol=1e-14)
    single = homography_dlt(a.float(), b.float())
    assert single.dtype == torch.float32
    apart = transfer(single.double(), a) - transfer(both, a)
    assert float(apart.abs().max()) < 2e-3  # pixels; float32 represents pixels only to 3e-5


def test_vmap_agrees():
    a = torch.stack((PLANE.x1, NOISY.x1))
    b = torch.stack((PLANE.x2, NOISY.x2))
    assert torch.allclose(
        torch.func.vmap(homography_dlt)(a, b), homography_dlt(a, b), rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("kind", ["collinear", "repeated"])
def test_degenerate_points_are_rejected(kind):
    x = torch.linspace(0, 10, 8, dtype=torch.float64)[:, None] * torch.tensor(
        [1.0, 2.0], dtype=torch.float64
    )
    if kind == "repeated":
        x = torch.ones(8, 2, dtype=torch.float64)
    with pytest.raises(DegenerateGeometryError, match="do not determine H"):
        homography_dlt(x, x + 3)


def test_too_few_points_and_wrong_weights_are_rejected():
    with pytest.raises(DegenerateGeometryError, match="at least 4"):
        homography_dlt(PLANE.x1[:3], PLANE.x2[:3])
    with pytest.raises(InputError, match="weights must have shape"):
        homography_dlt(PLANE.x1, PLANE.x2, torch.ones(3).double())
    with pytest.raises(InputError, match="must not be negative"):
        homography_dlt(PLANE.x1, PLANE.x2, -torch.ones(60).double())


@pytest.mark.grad
def test_derivatives():
    x1, x2 = (x[:8].clone().requires_grad_() for x in (NOISY.x1, NOISY.x2))
    w = torch.linspace(0.5, 1, 8, dtype=torch.float64).requires_grad_()
    assert gradcheck(homography_dlt, (x1, x2, w))
    assert gradcheck(lambda a, b: homography_4point(a[:4], b[:4]), (x1, x2))
    small = unit_norm(torch.linalg.inv(PLANE.K2) @ H @ PLANE.K1).requires_grad_()
    eye = torch.eye(3).double()
    assert gradcheck(lambda M: decompose_homography(M, eye, eye), (small,))
    xn = torch.rand(6, 2, dtype=torch.float64, requires_grad=True)
    for function in (
        squared_transfer_error,
        squared_symmetric_transfer_error,
        squared_homography_sampson_distance,
    ):
        assert gradcheck(lambda M, x, f=function: f(M, x, x.flip(0)), (small, xn))
