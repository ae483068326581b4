"""Sensitivity against automatic differentiation, influence against leaving a match out."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.lie import so3_log, tangent_basis
from sfmkit.geometry.sensitivity import influence, pose_sensitivity

D = torch.float64


@pytest.mark.grad
@pytest.mark.parametrize("loss, scale", [("squared", 1.0), ("cauchy", 0.7)])
def test_sensitivity_is_the_derivative(loss, scale):
    s = make_scene(12, noise=0.3)
    options = {"loss": loss, "loss_scale": scale, "max_iterations": 100}
    w = torch.linspace(0.5, 2, 12, dtype=D)
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, w, **options)
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, b.R, b.t, w, **options)

    def pose(x1: torch.Tensor, x2: torch.Tensor) -> torch.Tensor:
        moved = bundle_adjust(x1, x2, s.K1, s.K2, b.R, b.t, w, **options)
        return torch.cat((so3_log(moved.R @ b.R.T), tangent_basis(b.t).T @ moved.t))

    by1, by2 = torch.autograd.functional.jacobian(pose, (s.x1, s.x2))
    expected = torch.cat((by1, by2), -1).movedim(1, 0)
    torch.testing.assert_close(pose_sensitivity(b), expected, rtol=1e-3, atol=1e-7)


def test_influence_is_what_leaving_out_does():
    s = make_scene(60, noise=0.5)
    s.x2[7] += torch.tensor([4.0, -3.0])
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t)
    found = influence(b)
    assert int(found.cook.argmax()) == 7
    assert float(found.leverage.sum()) == pytest.approx(5)
    assert bool(((found.leverage > 0) & (found.leverage < 1)).all())
    for k in (7, 20, 33):
        kept = torch.arange(60) != k
        without = bundle_adjust(s.x1[kept], s.x2[kept], s.K1, s.K2, b.R, b.t)
        change = torch.cat((so3_log(without.R @ b.R.T), tangent_basis(b.t).T @ without.t))
        assert float((found.change[k] - change).norm()) < 0.1 * float(change.norm())


def test_a_batch_is_its_items():
    scenes = [make_scene(12, noise=0.5, seed=k) for k in range(2)]
    data = [(s.x1, s.x2, s.K1, s.K2, s.R, s.t) for s in scenes]
    together = bundle_adjust(*(torch.stack(a) for a in zip(*data)))
    for k, d in enumerate(data):
        alone = bundle_adjust(*d)
        torch.testing.assert_close(
            pose_sensitivity(together)[k], pose_sensitivity(alone), rtol=1e-6, atol=1e-10
        )
        torch.testing.assert_close(
            influence(together).cook[k], influence(alone).cook, rtol=1e-6, atol=1e-12
        )
