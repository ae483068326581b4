"""Pose refinement compared with an exact scene, SciPy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up_scene import make_scene
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck, gradgradcheck

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.fundamental import fundamental_from_pose, signed_sampson_distance
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.geometry.refinement import refine_essential


def start(s) -> tuple[torch.Tensor, torch.Tensor]:
    R = so3_exp(torch.tensor([0.02, -0.01, 0.015], dtype=torch.float64)) @ s.R
    return R, 2 * (s.t + torch.tensor([0.05, 0.04, -0.08], dtype=torch.float64))


@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy", "marginal"])
def test_exact_matches_give_the_exact_pose(loss):
    s = make_scene(100)
    fit = refine_essential(*start(s), s.x1, s.x2, s.K1, s.K2, loss=loss, loss_scale=40.0)
    assert bool(fit.converged)
    assert float(rotation_error(fit.R, s.R)) < 1e-9
    assert float(translation_error(fit.t, s.t)) < 1e-8


@pytest.mark.parametrize("loss, name", [("squared", "linear"), ("cauchy", "cauchy")])
def test_the_minimum_agrees_with_scipy(loss, name):
    s = make_scene(60, noise=0.7, outliers=0.1 if loss == "cauchy" else 0.0)

    def residuals(p: np.ndarray) -> np.ndarray:
        R = torch.from_numpy(Rotation.from_rotvec(p[:3]).as_matrix()) @ s.R
        t = torch.from_numpy(p[3:] / np.linalg.norm(p[3:]))
        return signed_sampson_distance(fundamental_from_pose(R, t, s.K1, s.K2), s.x1, s.x2).numpy()

    ours = refine_essential(*start(s), s.x1, s.x2, s.K1, s.K2, loss=loss, loss_scale=0.8)
    theirs = least_squares(
        residuals,
        np.r_[0, 0, 0, s.t.numpy()],
        loss=name,
        f_scale=0.8,
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert float(ours.cost[-1]) == pytest.approx(theirs.cost, rel=1e-9)
    R = torch.from_numpy(Rotation.from_rotvec(theirs.x[:3]).as_matrix()) @ s.R
    assert float(rotation_error(ours.R, R)) < 1e-4
    assert int(ours.iterations) < 15


def test_weights_of_zero_exclude_matches_and_the_cost_never_increases():
    s = make_scene(100, noise=0.3)
    w = torch.ones(100, dtype=torch.float64)
    w[:30] = 0
    weighted = refine_essential(*start(s), s.x1, s.x2, s.K1, s.K2, w)
    fewer = refine_essential(*start(s), s.x1[30:], s.x2[30:], s.K1, s.K2)
    assert torch.allclose(weighted.R, fewer.R, rtol=0, atol=1e-9)
    assert bool((weighted.cost.diff() <= 0).all())


def test_batch_equals_singles_and_float32_is_close():
    scenes = [make_scene(50, noise=0.5, seed=i) for i in range(3)]
    x1, x2 = torch.stack([s.x1 for s in scenes]), torch.stack([s.x2 for s in scenes])
    s = scenes[0]
    R0, t0 = start(s)
    both = refine_essential(R0, t0, x1, x2, s.K1, s.K2)
    for i in range(3):
        alone = refine_essential(R0, t0, x1[i], x2[i], s.K1, s.K2)
        assert torch.allclose(both.R[i], alone.R, rtol=0, atol=1e-8)
        assert torch.allclose(both.t[i], alone.t, rtol=0, atol=1e-8)
    single = refine_essential(*(a.float() for a in (R0, t0, x1, x2, s.K1, s.K2)))
    assert single.R.dtype == torch.float32
    assert float(rotation_error(single.R.double(), both.R).max()) < 1e-4


def test_bad_input_is_named():
    s = make_scene(10)
    with pytest.raises(DegenerateGeometryError, match="at least 5"):
        refine_essential(s.R, s.t, s.x1[:4], s.x2[:4], s.K1, s.K2)
    with pytest.raises(InputError, match="positive"):
        refine_essential(s.R, s.t, s.x1, s.x2, s.K1, s.K2, loss_scale=0.0)
    with pytest.raises(InputError):
        refine_essential(s.R, 0 * s.t, s.x1, s.x2, s.K1, s.K2)
    with pytest.raises(InputError, match="do not fit each other"):
        refine_essential(
            s.R.expand(3, 3, 3), s.t, s.x1.expand(2, -1, -1), s.x2.expand(2, -1, -1), s.K1, s.K2
        )


@pytest.mark.grad
@pytest.mark.parametrize("loss", ["squared", "cauchy", "marginal"])
def test_derivatives_of_the_minimum(loss):
    s = make_scene(12, noise=0.5)
    x1, x2 = s.x1.clone().requires_grad_(), s.x2.clone().requires_grad_()
    w = torch.linspace(0.5, 1, 12, dtype=torch.float64).requires_grad_()

    def pose(x1, x2, w, K1):
        fit = refine_essential(
            *start(s),
            x1,
            x2,
            K1,
            s.K2,
            w,
            loss=loss,
            loss_scale=30.0 if loss == "marginal" else 3.0,
        )
        return fit.R, fit.t

    values = (x1, x2, w)
    assert gradcheck(lambda *a: pose(*a, s.K1), values, atol=1e-5, fast_mode=True)
    assert gradgradcheck(
        lambda *a: pose(*a, s.K1), values, eps=1e-4, atol=1e-5, rtol=1e-3, fast_mode=True
    )
    x1, x2 = x1.detach(), x2.detach()
    one = torch.func.jacrev(lambda x: pose(x, x2, w.detach(), s.K1)[1])(x1)
    assert one.shape == (3, 12, 2)
    many = torch.func.vmap(torch.func.jacrev(lambda a, b: pose(a, b, w.detach(), s.K1)[1]))(
        x1[None], x2[None]
    )
    assert torch.allclose(
        one, many[0], rtol=1e-4, atol=1e-8
    )  # under vmap, all iterations are run; a single problem stops at convergence
