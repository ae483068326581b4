"""Two-view bundle adjustment compared with the truth, SciPy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_scene import Scene, make_scene
from scipy.optimize import least_squares

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.bundle import TwoViewBundle, bundle_adjust
from sfmkit.geometry.lie import so3_exp, sphere_exp, tangent_basis
from sfmkit.geometry.losses import loss_terms
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.geometry.reprojection import reprojection_residuals

D = torch.float64
LOSSES = [("squared", 1.0), ("huber", 0.7), ("cauchy", 0.7), ("marginal", 4.0)]


def start(s: Scene) -> tuple[torch.Tensor, torch.Tensor]:
    R = so3_exp(torch.tensor([0.02, -0.01, 0.015], dtype=D)) @ s.R
    return R, 2 * (s.t + torch.tensor([0.05, 0.04, -0.08], dtype=D))


def adjusted(s: Scene, *args, **options) -> TwoViewBundle:
    return bundle_adjust(s.x1, s.x2, s.K1, s.K2, *start(s), *args, **options)


def rescaled(K: torch.Tensor, f: float) -> torch.Tensor:
    return K * torch.tensor([[f, f, 1], [f, f, 1], [1, 1, 1]], dtype=D)


@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy"])
def test_exact_matches_give_the_exact_pose(loss):
    s = make_scene(100)
    b = adjusted(s, loss=loss)
    assert bool(b.converged)
    assert int(b.iterations) < 10
    assert float(rotation_error(b.R, s.R)) < 1e-10
    assert float(translation_error(b.t, s.t)) < 1e-10
    assert float(reprojection_residuals(b.X, s.x1, s.x2, s.K1, s.K2, b.R, b.t).abs().max()) < 1e-9


@pytest.mark.parametrize("loss, scale", LOSSES)
def test_the_minimum_agrees_with_scipy(loss, scale):
    s = make_scene(25, noise=0.5, seed=1)
    near = adjusted(s, loss="cauchy")  # the marginal loss is flat where the other start lies
    b = bundle_adjust(
        s.x1, s.x2, s.K1, s.K2, near.R, near.t, loss=loss, loss_scale=scale, max_iterations=200
    )
    assert bool(b.converged)

    def cost(p: torch.Tensor, X: torch.Tensor) -> torch.Tensor:
        """Each match's square root of the loss: SciPy then minimises their squares."""
        R, t = so3_exp(p[:3]) @ b.R, sphere_exp(b.t, tangent_basis(b.t) @ p[3:])
        r = reprojection_residuals(X, s.x1, s.x2, s.K1, s.K2, R, t)
        return loss_terms(loss, (r * r).sum(-1), scale).value

    assert float(b.cost[-1]) == pytest.approx(0.5 * float(cost(torch.zeros(5, dtype=D), b.X).sum()))

    def residuals(v: np.ndarray) -> np.ndarray:
        v = torch.from_numpy(v)
        return cost(v[:5], b.X + v[5:].reshape(-1, 3)).sqrt().numpy()

    def slopes(v: np.ndarray) -> np.ndarray:
        v = torch.from_numpy(v)
        return torch.func.jacrev(lambda v: cost(v[:5], b.X + v[5:].reshape(-1, 3)).sqrt())(
            v
        ).numpy()

    best = least_squares(residuals, np.zeros(80), slopes, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert best.cost == pytest.approx(float(b.cost[-1]), rel=1e-8)
    np.testing.assert_allclose(best.x[:5], 0, atol=1e-5)


@pytest.mark.parametrize("focal", ["shared", "separate"])
def test_free_focal_lengths_are_found(focal):
    s = make_scene(200)
    K1, K2 = rescaled(s.K1, 1.03), rescaled(s.K2, 1.03 if focal == "shared" else 0.98)
    b = bundle_adjust(s.x1, s.x2, K1, K2, *start(s), focal=focal)
    assert bool(b.converged)
    torch.testing.assert_close(b.K1, s.K1, rtol=1e-8, atol=1e-12)
    torch.testing.assert_close(b.K2, s.K2, rtol=1e-8, atol=1e-12)
    assert float(rotation_error(b.R, s.R)) < 1e-6


@pytest.mark.parametrize("loss, scale", LOSSES[2:])
def test_robust_losses_ignore_gross_errors(loss, scale):
    s = make_scene(200, noise=0.3, outliers=0.2)
    near = adjusted(s, loss="cauchy")  # the marginal loss is flat where the other start lies
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, near.R, near.t, loss=loss, loss_scale=scale)
    assert bool(b.converged)
    clean = bundle_adjust(s.x1[40:], s.x2[40:], s.K1, s.K2, *start(s))
    assert float(rotation_error(b.R, clean.R)) < 0.03
    assert float(translation_error(b.t, clean.t)) < 0.1
    assert float(translation_error(adjusted(s).t, clean.t)) > 1  # unlike least squares


def test_a_match_without_weight_has_no_effect():
    s = make_scene(60, noise=0.5)
    w = torch.ones(60, dtype=D)
    w[50:] = 0
    b = adjusted(s, w)
    few = bundle_adjust(s.x1[:50], s.x2[:50], s.K1, s.K2, *start(s))
    torch.testing.assert_close(b.R, few.R, rtol=0, atol=1e-8)
    torch.testing.assert_close(b.X[:50], few.X, rtol=1e-6, atol=0)
    double = adjusted(s, 2 * torch.ones(60, dtype=D))
    torch.testing.assert_close(double.R, adjusted(s).R, rtol=0, atol=1e-9)


def test_zero_iterations_only_triangulate():
    s = make_scene(20, noise=0.5)
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, max_iterations=0)
    torch.testing.assert_close(b.R, s.R)
    assert b.cost.shape == (1,)
    assert not bool(b.converged)


def test_a_batch_agrees_with_its_items_that_converge_at_different_rates():
    scenes = [make_scene(40, noise=n, seed=k) for k, n in enumerate((0.0, 0.5, 3.0))]
    stacked = [torch.stack(a) for a in zip(*((s.x1, s.x2, s.K1, s.K2, *start(s)) for s in scenes))]
    together = bundle_adjust(*stacked, loss="cauchy")
    for k, s in enumerate(scenes):
        alone = adjusted(s, loss="cauchy")
        torch.testing.assert_close(together.R[k], alone.R, rtol=0, atol=1e-13)
        torch.testing.assert_close(together.t[k], alone.t, rtol=0, atol=1e-12)
        assert int(together.iterations[k]) == int(alone.iterations)
    mapped = torch.func.vmap(lambda *a: bundle_adjust(*a, loss="cauchy").t)(*stacked)
    torch.testing.assert_close(mapped, together.t, rtol=0, atol=1e-7)


def test_float32_agrees_with_rounded_float64():
    s = make_scene(60, noise=0.5)
    inputs = [a.float() for a in (s.x1, s.x2, s.K1, s.K2, *start(s))]
    b32, b64 = bundle_adjust(*inputs), bundle_adjust(*(a.double() for a in inputs))
    assert b32.R.dtype == b32.X.dtype == torch.float32
    torch.testing.assert_close(b32.R, b64.R.float(), rtol=0, atol=1e-7)
    torch.testing.assert_close(b32.X, b64.X.float(), rtol=1e-6, atol=0)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.floats(0.2, 5.0))
def test_swapping_permuting_and_scaling(seed, scale):
    s = make_scene(30, noise=0.5, seed=seed)
    b = adjusted(s)
    assert bool(b.converged)
    R, t = start(s)
    swapped = bundle_adjust(s.x2, s.x1, s.K2, s.K1, R.T, -R.T @ t)
    assert float(rotation_error(swapped.R, b.R.T)) < 1e-4
    assert float(translation_error(swapped.t, -b.R.T @ b.t)) < 1e-3
    assert float(swapped.cost[-1]) == pytest.approx(float(b.cost[-1]), rel=1e-9)
    order = torch.randperm(30, generator=torch.Generator().manual_seed(seed))
    permuted = bundle_adjust(s.x1[order], s.x2[order], s.K1, s.K2, R, t)
    torch.testing.assert_close(permuted.X, b.X[order], rtol=1e-6, atol=1e-9)
    grow = torch.diag(torch.tensor([scale, scale, 1], dtype=D))
    larger = bundle_adjust(scale * s.x1, scale * s.x2, grow @ s.K1, grow @ s.K2, R, t)
    assert float(rotation_error(larger.R, b.R)) < 1e-4
    assert float(larger.cost[-1]) == pytest.approx(scale**2 * float(b.cost[-1]), rel=1e-9)


@pytest.mark.grad
@pytest.mark.parametrize(
    "loss, scale, focal",
    [
        ("squared", 1.0, "shared"),
        ("huber", 0.7, "fixed"),
        ("cauchy", 0.7, "fixed"),
        ("marginal", 4.0, "fixed"),
    ],
)
def test_derivatives_at_the_minimum(loss, scale, focal):
    s = make_scene(20, noise=0.3, seed=2)
    g = torch.Generator().manual_seed(3)
    w = torch.rand(20, generator=g, dtype=D) + 0.5
    options = {"loss": loss, "loss_scale": scale, "focal": focal, "max_iterations": 200}
    at = bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, w, **options)
    into = [torch.randn(a.shape, generator=g, dtype=D) for a in (at.R, at.t, at.X, at.K1)]

    def outcome(*data: torch.Tensor) -> torch.Tensor:
        x1, x2, w, K1, K2 = data
        b = bundle_adjust(x1, x2, K1, K2, at.R, at.t, w, **options)
        return sum((a * i).sum() for a, i in zip((b.R, b.t, b.X, b.K1), into))

    data = [a.clone().requires_grad_() for a in (s.x1, s.x2, w, s.K1, s.K2)]
    slopes = torch.autograd.grad(outcome(*data), data)
    upper = torch.tensor([[1, 1, 1], [0, 1, 1], [0, 0, 0]], dtype=D)
    h = 1e-3
    for k, slope in enumerate(slopes):
        v = torch.randn(data[k].shape, generator=g, dtype=D) * (
            upper if k > 2 else 0.1 if k == 2 else 1.0
        )
        up, down = (
            outcome(*(a + f * h * v if i == k else a for i, a in enumerate(data))) for f in (1, -1)
        )
        assert float((slope * v).sum()) == pytest.approx(
            float(((up - down) / (2 * h)).detach()), rel=1e-3, abs=1e-4
        )


@pytest.mark.grad
def test_derivatives_under_transforms_and_at_exact_matches():
    s = make_scene(10, noise=0.3)
    fit = lambda x: bundle_adjust(x, s.x2, s.K1, s.K2, s.R, s.t, max_iterations=8).t  # noqa: E731
    by_autograd = torch.autograd.functional.jacobian(fit, s.x1)
    torch.testing.assert_close(torch.func.jacrev(fit)(s.x1), by_autograd, rtol=1e-5, atol=1e-9)
    s = make_scene(10)
    assert torch.autograd.functional.jacobian(fit, s.x1).isfinite().all()


def test_bad_input_is_named():
    s = make_scene(10)
    pose = s.R, s.t
    with pytest.raises(DegenerateGeometryError, match="too few"):
        bundle_adjust(s.x1[:4], s.x2[:4], s.K1, s.K2, *pose)
    with pytest.raises(DegenerateGeometryError, match="positive weight"):
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, *pose, torch.zeros(10, dtype=D))
    with pytest.raises(InputError, match="focal"):
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, *pose, focal="free")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="loss"):
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, *pose, loss="square")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="loss_scale"):
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, *pose, loss_scale=0.0)
    with pytest.raises(InputError, match="NaN"):
        bundle_adjust(s.x1 * torch.nan, s.x2, s.K1, s.K2, *pose)
    with pytest.raises(InputError, match="baseline"):
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, 0 * s.t)


@pytest.mark.data
def test_fountain_converges_quickly_and_agrees_with_the_truth(data_dir):
    import cv2

    from sfmkit.datasets.strecha import strecha
    from sfmkit.geometry.essential import essential_from_pose
    from sfmkit.geometry.fundamental import fundamental_from_essential, signed_sampson_distance

    pair = next(iter(strecha(data_dir / "strecha", ["fountain-P11"])))
    size = tuple(v // 4 for v in pair.camera1.size_wh)
    images = [
        cv2.resize(cv2.imread(str(f), 0), size, interpolation=cv2.INTER_AREA)
        for f in (pair.image1, pair.image2)
    ]
    K1, K2 = (torch.tensor(c.scaled(size).K) for c in (pair.camera1, pair.camera2))
    R, t = torch.as_tensor(pair.R, dtype=D), torch.as_tensor(pair.t, dtype=D)
    (k1, d1), (k2, d2) = (cv2.SIFT_create(1500).detectAndCompute(i, None) for i in images)
    matches = [a for a, b in cv2.BFMatcher().knnMatch(d1, d2, 2) if a.distance < 0.8 * b.distance]
    x1 = torch.tensor([k1[m.queryIdx].pt for m in matches], dtype=D)
    x2 = torch.tensor([k2[m.trainIdx].pt for m in matches], dtype=D)
    F = fundamental_from_essential(essential_from_pose(R, t), K1, K2)
    near = signed_sampson_distance(F, x1, x2).abs() < 1
    x1, x2 = x1[near], x2[near]
    R0 = so3_exp(torch.tensor([0.01, -0.01, 0.005], dtype=D)) @ R
    for loss, scale in (("squared", 1.0), ("huber", 0.5), ("cauchy", 0.5)):
        for focal in ("fixed", "shared"):
            b = bundle_adjust(x1, x2, K1, K2, R0, t, loss=loss, loss_scale=scale, focal=focal)
            assert bool(b.converged)
            assert int(b.iterations) < 15
            if focal == "fixed":
                assert float(rotation_error(b.R, R)) < 0.1
                assert float(translation_error(b.t, t)) < 0.3


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_agrees_with_the_cpu():
    s = make_scene(50, noise=0.5)
    here = adjusted(s, loss="cauchy")
    there = bundle_adjust(*(a.cuda() for a in (s.x1, s.x2, s.K1, s.K2, *start(s))), loss="cauchy")
    torch.testing.assert_close(there.R.cpu(), here.R, rtol=0, atol=1e-9)
    torch.testing.assert_close(there.X.cpu(), here.X, rtol=1e-6, atol=1e-9)
