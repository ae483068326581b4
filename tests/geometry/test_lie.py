"""Rotations and directions compared with matrix exponentials and closed forms."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

from sfmkit.geometry.lie import hat, so3_exp, so3_log, sphere_exp, tangent_basis

D = torch.float64
ANGLES = [0.0, 1e-12, 1e-6, 0.02, 0.0316, 0.04, 1.0, 3.0, math.pi - 1e-6]


def directions(n: int = 20) -> torch.Tensor:
    g = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=g, dtype=D), dim=-1)


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_and_logarithm(angle):
    w = angle * directions()
    R = so3_exp(w)
    torch.testing.assert_close(R, torch.linalg.matrix_exp(hat(w)), rtol=0, atol=2e-14)
    torch.testing.assert_close(R @ R.mT, torch.eye(3, dtype=D).expand(20, 3, 3), rtol=0, atol=4e-15)
    torch.testing.assert_close(so3_log(R), w, rtol=1e-9, atol=1e-15)


def test_rotations_by_180_degrees_have_an_axis():
    n = directions()
    R = 2 * n[:, :, None] * n[:, None, :] - torch.eye(3, dtype=D)
    w = so3_log(R)
    torch.testing.assert_close(w.norm(dim=-1), torch.full((20,), math.pi, dtype=D))
    torch.testing.assert_close((w * n).sum(-1).abs(), torch.full((20,), math.pi, dtype=D))


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: sum(c * c for c in v) > 1e-3),
    st.floats(-3, 3),
)
def test_tangent_basis_and_great_circles(t, angle):
    t = torch.nn.functional.normalize(torch.tensor(t, dtype=D), dim=-1)
    B = tangent_basis(t)
    frame = torch.cat((t[:, None], B), -1)
    torch.testing.assert_close(frame.T @ frame, torch.eye(3, dtype=D))
    assert float(torch.linalg.det(frame)) == pytest.approx(1)
    moved = sphere_exp(t, angle * B[:, 0])
    torch.testing.assert_close(moved, math.cos(angle) * t + math.sin(angle) * B[:, 0])


@pytest.mark.grad
@pytest.mark.parametrize("angle", [0.0, 0.02, 1.0, 3.0])
def test_derivatives(angle):
    w = (angle * directions(1)).requires_grad_()
    for function in (
        so3_exp,
        lambda v: so3_log(so3_exp(v)),
        lambda v: sphere_exp(directions(1), v),
    ):
        assert gradcheck(function, (w,))
        assert gradgradcheck(function, (w,))
    torch.testing.assert_close(torch.func.vmap(so3_log)(so3_exp(w)), so3_log(so3_exp(w)))
