"""Derivatives of the two-view minimum by the data, without the iterations that found it.

At the minimum the gradient g(unknowns; data) vanishes and stays so when the data moves:
``d unknowns = -H^-1 dg``, with the exact Hessian H. It has the same arrow shape as the Gauss-Newton
matrix and is eliminated the same way.

Source: implicit function theorem; Krantz and Parks 2002; for bundle adjustment, Triggs et al. 2000,
section 10.1.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ._forward_mode import forward_mode
from ._rays import Vector
from ._two_view_problem import Problem, State


class Hessian(NamedTuple):
    """The exact second derivatives of the cost, points eliminated."""

    camera: Tensor  # (*B, m, m) reduced: what remains for the camera
    mixed: Tensor  # (*B, 3, m, N) points by camera
    inverse: Tensor  # (*B, 3, 3, N) inverse of every point's own block

    def pull_points(self, g: Tensor) -> Tensor:
        """``H_yy^-1 g`` for g ``(*B, 3, ..., N)``."""
        return torch.einsum("...ijn,...jn->...in", self.inverse, g)


def gradient(camera: Tensor, y: Tensor, state: State, problem: Problem) -> tuple[Tensor, Tensor]:
    """The cost's gradient by the camera step (*B, m) and the points (*B, 3, N), at a step away from
    `state`."""

    def cost(camera: Tensor, y: Tensor) -> Tensor:
        moved = problem.move(state._replace(y=_vector(y)), camera)
        return problem.cost(moved).sum()

    return torch.func.grad(cost, argnums=(0, 1))(camera, y)


def hessian(state: State, problem: Problem) -> Hessian:
    """The blocks of the exact Hessian: one product with a direction per camera unknown and three
    for all points."""
    m = problem.size
    y = torch.stack(state.y, -2)
    zero = torch.zeros_like(state.t[..., :1]).repeat_interleave(m, -1)

    def along(camera: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        direction = camera.expand_as(zero).clone(), points.expand_as(y).clone()
        with forward_mode():
            return torch.func.jvp(
                lambda c, p: gradient(c, p, state, problem), (zero, y), direction
            )[1]

    eye_c = torch.eye(m, dtype=y.dtype, device=y.device)
    eye_y = torch.eye(3, dtype=y.dtype, device=y.device)
    columns = [along(e, torch.zeros_like(y)) for e in eye_c]
    Hcc = torch.stack([c for c, _ in columns], -1)
    Hyc = torch.stack([p for _, p in columns], -2)
    Hyy = torch.stack([along(torch.zeros_like(zero), e[:, None])[1] for e in eye_y], -2)
    inverse = _inverse3(Hyy)
    reduced = Hcc - torch.einsum(
        "...kmn,...kjn->...mj", Hyc, torch.einsum("...kln,...ljn->...kjn", inverse, Hyc)
    )
    return Hessian(reduced, Hyc, inverse)


def attach_derivatives(state: State, fixed: Problem, problem: Problem) -> State:
    """One exact Newton step from the minimum, recorded through the data only: same values, first
    derivatives right."""
    H = hessian(state, fixed)
    y = torch.stack(state.y, -2)
    zero = torch.zeros_like(state.t[..., :1]).repeat_interleave(fixed.size, -1)
    g_camera, g_points = gradient(zero, y, state, problem)
    own = H.pull_points(g_points)
    camera = -torch.linalg.solve(
        H.camera, g_camera - torch.einsum("...kmn,...kn->...m", H.mixed, own)
    )
    points = -own - H.pull_points(torch.einsum("...kmn,...m->...kn", H.mixed, camera))
    return problem.move(state, camera, _vector(points))


def _vector(y: Tensor) -> Vector:
    u, v, w = y.unbind(-2)
    return u, v, w


def _inverse3(A: Tensor) -> Tensor:
    """The inverse of symmetric ``(*B, 3, 3, N)``, closed form."""
    (a, b, c), (_, d, e), (_, _, f) = (row.unbind(-2) for row in A.unbind(-3))
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    dd, de, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * ab + c * ac
    rows = (
        torch.stack((aa, ab, ac), -2),
        torch.stack((ab, dd, de), -2),
        torch.stack((ac, de, ff), -2),
    )
    return torch.stack(rows, -3) / determinant[..., None, None, :]
