"""Homography refinement compared with finite differences and with itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up_scene import make_scene
from scipy.optimize import minimize
from torch.autograd import gradcheck, gradgradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.homography import homography_from_pose, transfer
from sfmkit.geometry.homography_refinement import refine_homography
from sfmkit.geometry.losses import loss_terms

D = torch.float64
S = make_scene(14, noise=0.4, planar=True)
START = homography_from_pose(S.R, S.t, S.normal, S.distance, S.K1, S.K2)
START = START / START[2, 2]
W = torch.linspace(0.5, 1.5, 14, dtype=D)
CORNERS = torch.tensor([[0.0, 0], [640, 0], [640, 480], [0, 480]], dtype=D)


def test_the_minimum_agrees_with_scipy():
    def cost(h):
        """Return the loss of ``r^T (I + A A^T)^-1 r`` with A the derivative of the transfer."""
        H = torch.cat((h, torch.ones(1, dtype=D))).view(3, 3) * START
        A = torch.func.vmap(torch.func.jacrev(lambda x: transfer(H, x[None])[0]))(S.x1)
        r = S.x2 - transfer(H, S.x1)
        square = (r * torch.linalg.solve(torch.eye(2, dtype=D) + A @ A.mT, r)).sum(-1)
        return 0.5 * (W * loss_terms("marginal", square.clamp(max=25.0), 5.0).value).sum()

    def slope_and_cost(h):
        slope, value = torch.func.grad_and_value(cost)(torch.from_numpy(h.copy()))
        return float(value), slope.numpy()

    H = refine_homography(START, S.x1, S.x2, W, threshold_px=5.0, max_iterations=50)
    ours = float(cost((H / START).flatten()[:8]))
    theirs = minimize(slope_and_cost, np.ones(8), jac=True, method="BFGS", options={"gtol": 1e-9})
    assert ours == pytest.approx(theirs.fun, rel=1e-11)
    assert ours < 0.7 * slope_and_cost(np.ones(8))[0]


@pytest.mark.grad
def test_first_and_second_derivatives_agree_with_finite_differences():
    def corners(x1, x2, w):  # pixels: the entries of H differ by orders of magnitude
        H = refine_homography(START, x1, x2, w, threshold_px=5.0, max_iterations=60)
        return transfer(H, CORNERS)

    values = tuple(v.clone().requires_grad_() for v in (S.x1, S.x2, W))
    assert gradcheck(corners, values, eps=1e-5, atol=1e-5, rtol=1e-4)
    assert gradgradcheck(corners, values, eps=1e-5, atol=1e-4, rtol=1e-3, fast_mode=True)
    plain = corners(S.x1, S.x2, W)
    torch.testing.assert_close(corners(*values).detach(), plain, rtol=0, atol=1e-5)


def test_a_batch_and_vmap_agree_with_single_problems():
    scenes = [make_scene(30, noise=0.4, planar=True, seed=k) for k in range(3)]
    x1, x2 = torch.stack([s.x1 for s in scenes]), torch.stack([s.x2 for s in scenes])
    starts = torch.stack(
        [homography_from_pose(s.R, s.t, s.normal, s.distance, s.K1, s.K2) for s in scenes]
    )
    together = refine_homography(starts, x1, x2)
    single = torch.stack([refine_homography(*a) for a in zip(starts, x1, x2)])
    assert float((together - starts / starts[:, 2:, 2:]).abs().max()) > 1e-4
    moved = transfer(together, CORNERS.expand(3, 4, 2))
    torch.testing.assert_close(moved, transfer(single, CORNERS.expand(3, 4, 2)), rtol=0, atol=1e-4)
    mapped = torch.func.vmap(refine_homography)(starts, x1, x2)
    torch.testing.assert_close(moved, transfer(mapped, CORNERS.expand(3, 4, 2)), rtol=0, atol=1e-4)
    low = refine_homography(starts.float(), x1.float(), x2.float())
    assert low.dtype == torch.float32


def test_several_initial_homographies_share_one_set_of_matches():
    shift = torch.tensor([[1.0, 0, 2], [0, 1, -1], [0, 0, 1]], dtype=D)
    starts = torch.stack([START, shift @ START, START @ shift])
    together = refine_homography(starts, S.x1, S.x2)
    single = torch.stack([refine_homography(start, S.x1, S.x2) for start in starts])
    moved = transfer(together, CORNERS.expand(3, 4, 2))
    torch.testing.assert_close(moved, transfer(single, CORNERS.expand(3, 4, 2)), rtol=0, atol=1e-4)


def test_too_few_matches_within_the_threshold_return_the_start_without_derivative():
    x2 = S.x2 + 50
    x2[:7] -= 50
    x1 = S.x1.clone().requires_grad_()
    H = refine_homography(3 * START, x1, x2)
    torch.testing.assert_close(H.detach(), START)
    (grad,) = torch.autograd.grad(H.sum(), x1)
    assert not grad.any()


def test_bad_input_is_named():
    with pytest.raises(InputError, match="threshold_px"):
        refine_homography(START, S.x1, S.x2, threshold_px=0.0)
    with pytest.raises(InputError, match="batch dimensions"):
        refine_homography(START.expand(3, 3, 3), S.x1.expand(2, -1, -1), S.x2.expand(2, -1, -1))
