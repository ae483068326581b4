"""Triangulation compared with known points, OpenCV, kornia and brute-force minimisation."""

from __future__ import annotations

import cv2
import kornia.geometry.epipolar as kornia_epipolar
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from torch.autograd import gradcheck

from sfmkit.errors import InputError
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.triangulation import (
    corrected_matches,
    parallax,
    triangulate,
    triangulate_dlt,
    triangulate_midpoint,
    triangulate_optimal,
)

METHODS = ("optimal", "midpoint", "dlt")
D = torch.float64


def scene(n: int = 50, noise: float = 0.0, seed: int = 0, baseline: float = 1.0):
    g = torch.Generator().manual_seed(seed)
    X = torch.rand(n, 3, generator=g, dtype=D) * torch.tensor([4.0, 3.0, 4.0]) + torch.tensor(
        [-2.0, -1.5, 4.0]
    )
    R = so3_exp(torch.tensor([0.1, -0.2, 0.05], dtype=D))
    t = baseline * torch.tensor([1.0, 0.2, -0.1], dtype=D)
    xn1, xn2 = seen(X), seen(X @ R.T + t)
    xn1 = xn1 + noise * torch.randn(n, 2, generator=g, dtype=D)
    return X, xn1, xn2 + noise * torch.randn(n, 2, generator=g, dtype=D), R, t


def seen(X: torch.Tensor) -> torch.Tensor:
    return X[..., :2] / X[..., 2:]


def relative(X: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    return (X - truth).norm(dim=-1) / truth.norm(dim=-1)


def projection_matrices(R, t) -> tuple[np.ndarray, np.ndarray]:
    return np.eye(3, 4), np.hstack((R.numpy(), t.numpy()[:, None]))


@pytest.mark.parametrize("method", METHODS)
def test_exact_matches_give_the_points(method):
    X, xn1, xn2, R, t = scene()
    torch.testing.assert_close(triangulate(xn1, xn2, R, t, method), X, rtol=1e-12, atol=1e-12)
    H = triangulate(xn1, xn2, R, t, method, homogeneous=True)
    torch.testing.assert_close(H[:, :3] / H[:, 3:], X, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(H.norm(dim=-1), torch.ones(50, dtype=D))


def test_dlt_agrees_with_opencv_and_kornia():
    _, xn1, xn2, R, t = scene(noise=0.01)
    P1, P2 = projection_matrices(R, t)
    Y = cv2.triangulatePoints(P1, P2, xn1.numpy().T, xn2.numpy().T)
    ours = triangulate_dlt(xn1, xn2, R, t)
    torch.testing.assert_close(ours, torch.from_numpy((Y[:3] / Y[3]).T), rtol=1e-9, atol=1e-9)
    theirs = kornia_epipolar.triangulate_points(
        *(torch.from_numpy(P)[None] for P in (P1, P2)), xn1[None], xn2[None]
    )
    torch.testing.assert_close(ours, theirs[0], rtol=1e-9, atol=1e-9)


def test_the_midpoint_minimises_the_distances_from_both_rays():
    _, xn1, xn2, R, t = scene(10, noise=0.02)
    ours = triangulate_midpoint(xn1, xn2, R, t)
    for x1, x2, X in zip(xn1, xn2, ours):
        a, b = torch.cat((x1, torch.ones(1))), R.T @ torch.cat((x2, torch.ones(1)))
        # Distances to the rays 0 + s a and c + r b, projected on their normal planes.
        Na, Nb = (
            torch.eye(3, dtype=D) - torch.outer(v, v) / (v @ v) for v in (a.double(), b.double())
        )
        c = -R.T @ t
        torch.testing.assert_close(X, torch.linalg.solve(Na + Nb, Nb @ c), rtol=1e-9, atol=1e-9)


def test_optimal_agrees_with_the_brute_force_minimum():
    X, xn1, xn2, R, t = scene(25, noise=0.02, seed=3)
    ours = triangulate_optimal(xn1, xn2, R, t)
    R_, t_ = R.numpy(), t.numpy()
    for k in range(25):

        def residuals(p, k=k):
            q = R_ @ p + t_
            return np.concatenate((p[:2] / p[2] - xn1[k].numpy(), q[:2] / q[2] - xn2[k].numpy()))

        best = least_squares(residuals, X[k].numpy(), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        cost = (residuals(ours[k].numpy()) ** 2).sum()
        # below by no more than rounding
        assert 2 * best.cost * (1 - 1e-12) <= cost <= 2 * best.cost * (1 + 1e-6)
        np.testing.assert_allclose(ours[k].numpy(), best.x, rtol=1e-3)


def test_corrected_matches_satisfy_the_epipolar_constraint():
    _, xn1, xn2, R, t = scene(noise=0.02)
    (x1, y1), (x2, y2) = corrected_matches(xn1, xn2, R, t)
    h1, h2 = (torch.stack((x, y, torch.ones_like(x)), -1) for x, y in ((x1, y1), (x2, y2)))
    volume = (h2 * torch.linalg.cross(t.expand_as(h1), h1 @ R.T)).sum(-1)
    assert float(volume.abs().max()) < 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_points_at_infinity_and_beyond(method):
    R, t = so3_exp(torch.tensor([0.0, 0.1, 0.0], dtype=D)), torch.tensor([1.0, 0.0, 0.0], dtype=D)
    d = torch.tensor([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.0]], dtype=D)
    xn1, xn2 = seen(d), seen(d @ R.T)
    H = triangulate(xn1, xn2, R, t, method, homogeneous=True)
    torch.testing.assert_close(H[:, :3], d / d.norm(dim=-1, keepdim=True), atol=1e-7, rtol=0)
    assert float(H[:, 3].abs().max()) < 1e-7
    assert not triangulate(xn1, xn2, R, t, method).isnan().any()
    # Rays that meet behind both cameras.
    behind = torch.tensor([[0.3, 0.2, -5.0]], dtype=D)
    H = triangulate(seen(behind), seen(behind @ R.T + t), R, t, method, homogeneous=True)
    assert float(H[0, 2]) > 0 > float(H[0, 3])
    torch.testing.assert_close(H[:, :3] / H[:, 3:], behind)


@pytest.mark.parametrize("method", METHODS)
def test_exactly_parallel_rays_and_the_epipole(method):
    eye, t = torch.eye(3, dtype=D), torch.tensor([0.0, 0.0, 1.0], dtype=D)
    xn = torch.tensor([[0.0, 0.0], [0.25, 0.5]], dtype=D)  # the epipole itself, and a parallel pair
    X = triangulate(xn, xn, eye, t, method)
    assert not X.isnan().any()
    assert X[1].isinf().all()
    assert triangulate(xn, xn, eye, t, method, homogeneous=True).isfinite().all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("baseline", [1.0, 1e-3])
def test_float32_agrees_with_rounded_float64(method, baseline):
    X, *rest = scene(baseline=baseline)
    rest32 = [a.float() for a in rest]
    exact = triangulate(*(a.double() for a in rest32), method)
    ours = triangulate(*rest32, method)
    assert ours.dtype == torch.float32
    torch.testing.assert_close(ours, exact.float(), rtol=1e-6, atol=0)
    # What the rounding of the input itself does to the depth, 6e-8 over a parallax of baseline / 6,
    # cannot be avoided.
    assert float(relative(ours.double(), X).max()) < 3e-6 / baseline


@pytest.mark.parametrize("dtype, tolerance", [(D, 1e-9), (torch.float32, 1e-3)])
@pytest.mark.parametrize("degrees", [1e-6, 0.01, 1.0, 90.0, 170.0])
def test_parallax(dtype, tolerance, degrees):
    angle = torch.deg2rad(torch.tensor(degrees, dtype=D))
    R = so3_exp(torch.stack((angle * 0, angle, angle * 0)))
    x = torch.tensor([[0.0, 0.0]], dtype=D)
    found = parallax(x.to(dtype), x.to(dtype), R.to(dtype))
    assert found.dtype == dtype
    torch.testing.assert_close(found.double()[0], angle, rtol=tolerance, atol=0)


@pytest.mark.parametrize(
    "function", [*(lambda *a, m=m: triangulate(*a, m, True) for m in METHODS), parallax]
)
def test_a_batch_agrees_with_its_items(function):
    items = [scene(seed=s, noise=0.01)[1:] for s in range(3)]
    if function is parallax:
        items = [i[:3] for i in items]
    together = function(*(torch.stack(a) for a in zip(*items)))
    torch.testing.assert_close(
        together, torch.stack([function(*i) for i in items]), rtol=1e-14, atol=1e-15
    )
    mapped = torch.func.vmap(function)(*(torch.stack(a) for a in zip(*items)))
    torch.testing.assert_close(mapped, together, rtol=1e-13, atol=1e-14)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from(METHODS))
def test_swapping_and_permuting(seed, method):
    _, xn1, xn2, R, t = scene(20, noise=0.01, seed=seed)
    X = triangulate(xn1, xn2, R, t, method)
    swapped = triangulate(xn2, xn1, R.T, -R.T @ t, method)
    # The algebraic error of the DLT depends on the frame: its result changes in second order.
    assert float(relative(swapped, X @ R.T + t).max()) < (1e-2 if method == "dlt" else 1e-6)
    order = torch.randperm(20, generator=torch.Generator().manual_seed(seed))
    torch.testing.assert_close(
        triangulate(xn1[order], xn2[order], R, t, method), X[order], rtol=1e-13, atol=1e-13
    )
    scaled = triangulate(xn1, xn2, R, 3 * t, method)
    assert float(relative(scaled, 3 * X).max()) < (1e-2 if method == "dlt" else 1e-9)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.sampled_from(METHODS))
def test_rotating_the_world(w, method):
    X, _, xn2, R, t = scene(20)
    Q = so3_exp(torch.tensor(w, dtype=D))
    turned = triangulate(seen(X @ Q.T), xn2, R @ Q.T, t, method)
    torch.testing.assert_close(turned, X @ Q.T, rtol=1e-10, atol=1e-10)


@pytest.mark.grad
@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("method", METHODS)
def test_derivatives(method, noise):
    _, *args = scene(3, noise=noise)
    args = [a.requires_grad_() for a in args]
    assert gradcheck(lambda *a: triangulate(*a, method), args)
    assert gradcheck(lambda *a: triangulate(*a, method, homogeneous=True), args)
    J = torch.func.jacrev(lambda x: triangulate(x, *args[1:], method))(args[0])
    assert J.isfinite().all()


@pytest.mark.grad
def test_derivatives_of_parallax():
    _, xn1, xn2, R, _ = scene(3)
    assert gradcheck(parallax, (xn1.requires_grad_(), xn2.requires_grad_(), R.requires_grad_()))
    x = torch.zeros(1, 2, dtype=D, requires_grad=True)
    parallax(x, x, torch.eye(3, dtype=D)).sum().backward()
    assert x.grad.isfinite().all()


@pytest.mark.parametrize("function", [triangulate_optimal, triangulate_midpoint, triangulate_dlt])
def test_bad_input_is_named(function):
    _, xn1, xn2, R, t = scene(4)
    with pytest.raises(InputError, match="baseline"):
        function(xn1, xn2, R, 0 * t)
    with pytest.raises(InputError, match="NaN"):
        function(xn1 * torch.nan, xn2, R, t)
    with pytest.raises(InputError, match="xn2"):
        function(xn1, xn2[:3], R, t)
    with pytest.raises(InputError, match="float32"):
        function(xn1.long(), xn2.long(), R, t)
    with pytest.raises(InputError, match="float32"):
        function(xn1.float(), xn2, R, t)


def test_unknown_method():
    with pytest.raises(InputError, match="optimal"):
        triangulate(*scene(4)[1:], "best")  # type: ignore[arg-type]
