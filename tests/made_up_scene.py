"""A scene whose answer is known: points before two different cameras."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sfmkit.geometry.lie import so3_exp


@dataclass(frozen=True)
class Scene:
    x1: Tensor
    x2: Tensor
    K1: Tensor
    K2: Tensor
    R: Tensor
    t: Tensor
    normal: Tensor  # of the plane z = 6 + 0.3 x - 0.2 y, on which the points of a planar scene lie
    distance: Tensor


def make_scene(
    n: int = 100, noise: float = 0.0, seed: int = 0, outliers: float = 0.0, planar: bool = False
) -> Scene:
    g = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=g, dtype=torch.float64)

    X = rand(n, 3) * torch.tensor([4.0, 3.0, 4.0]) + torch.tensor([-2.0, -1.5, 4.0])
    if planar:
        X[:, 2] = 6 + 0.3 * X[:, 0] - 0.2 * X[:, 1]
    R = so3_exp(torch.tensor([0.1, -0.2, 0.05], dtype=torch.float64))
    t = torch.nn.functional.normalize(torch.tensor([1.0, 0.2, -0.1], dtype=torch.float64), dim=0)
    K1 = torch.tensor(
        [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]], dtype=torch.float64
    )
    K2 = torch.tensor(
        [[900.0, 1.0, 300.0], [0.0, 890.0, 250.0], [0.0, 0.0, 1.0]], dtype=torch.float64
    )

    def seen(Y: Tensor, K: Tensor) -> Tensor:
        y = Y @ K.T
        return y[:, :2] / y[:, 2:] + noise * torch.randn(n, 2, generator=g, dtype=torch.float64)

    x1, x2 = seen(X, K1), seen(X @ R.T + t, K2)
    wrong = int(outliers * n)
    x2[:wrong] = rand(wrong, 2) * torch.tensor([640.0, 480.0])
    normal = torch.tensor([-0.3, 0.2, 1.0], dtype=torch.float64)
    return Scene(x1, x2, K1, K2, R, t, normal / normal.norm(), 6 / normal.norm())


def same_up_to_sign(A: Tensor, B: Tensor) -> Tensor:
    """Distance between matrices that are defined up to sign."""
    return torch.minimum((A - B).flatten(-2).norm(dim=-1), (A + B).flatten(-2).norm(dim=-1))
