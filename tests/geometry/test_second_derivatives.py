"""Second derivatives of implicitly differentiated solvers compared with finite differences."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from made_up_scene import make_scene
from torch import Tensor

from sfmkit.geometry import (
    decompose_essential,
    decompose_homography,
    epipoles,
    essential_5point,
    essential_from_fundamental,
    fundamental_7point,
    fundamental_8point,
    homography_4point,
    homography_dlt,
    homography_from_pose,
    project_to_essential,
)

D = torch.float64
G = torch.Generator().manual_seed(0)


def rand(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=G, dtype=D)


def signed(M: Tensor) -> Tensor:
    """Return the matrix with a positive largest entry."""
    flat = M.detach().flatten()
    return M * flat[flat.abs().argmax()].sign()


E0, A, X1, X2 = rand(3, 3), rand(3, 3), rand(12, 2), rand(12, 2)
H2 = X1 + 0.1 * rand(12, 2)
K = torch.tensor([[3.0, 0.1, 0.2], [0.0, 2.0, 0.1], [0.0, 0.0, 1.0]], dtype=D)
P = make_scene(planar=True)
H0 = homography_from_pose(P.R, P.t, P.normal, P.distance, K, K)

CASES: dict[str, tuple[Callable[[Tensor], Tensor], Tensor]] = {
    "project_to_essential": (project_to_essential, E0),
    "decompose_essential": (lambda z: decompose_essential(z)[0][0], E0),
    "essential_from_fundamental": (lambda z: essential_from_fundamental(z, K, K), E0),
    "essential_5point": (lambda z: signed(essential_5point(z, X2[:5] * 0.3)[0][0]), X1[:5] * 0.3),
    "fundamental_7point": (lambda z: signed(fundamental_7point(z, X2[:7])[0][0]), X1[:7]),
    "fundamental_8point": (lambda z: signed(fundamental_8point(z, X2)), X1),
    "epipoles": (lambda z: signed(epipoles(z)[0]), fundamental_8point(X1, X2)),
    "homography_dlt": (lambda z: homography_dlt(z, H2), X1),
    "homography_dlt, weights": (lambda w: homography_dlt(X1, H2, w), rand(12).exp()),
    "homography_4point": (lambda z: homography_4point(z, H2[:4]), X1[:4]),
    "decompose_homography": (lambda z: decompose_homography(z, K, K)[1][0], H0),
}


@pytest.mark.parametrize("name", CASES)
def test_second_derivative_agrees_with_differences_of_the_first(name):
    function, z = CASES[name]
    v = rand(*z.shape)

    def gradient(y: Tensor) -> Tensor:
        value = function(y)
        weights = A if value.ndim == 2 else A[0]
        return torch.autograd.grad((value * weights).sum(), y, create_graph=True)[0]

    y = z.clone().requires_grad_()
    product = torch.autograd.grad((gradient(y) * v).sum(), y)[0]
    step = 1e-6
    ahead, behind = (gradient((z + h * v).requires_grad_()).detach() for h in (step, -step))
    numeric = (ahead - behind) / (2 * step)
    assert float((product - numeric).norm() / numeric.norm()) < 1e-6


def test_forward_over_reverse_agrees_with_reverse_over_reverse():
    def total(z: Tensor) -> Tensor:
        return (homography_dlt(z, H2) * A).sum()

    forward = torch.func.jacfwd(torch.func.grad(total))(X1)
    reverse = torch.func.jacrev(torch.func.grad(total))(X1)
    torch.testing.assert_close(forward, reverse, rtol=1e-8, atol=1e-8)
