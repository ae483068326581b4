"""The exact Hessian of two-view bundle adjustment, for its implicit derivatives.

The Hessian has the same arrow structure as the Gauss-Newton matrix, with one small block per point
and a border for the camera. The system is solved by the same elimination of the points.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ._implicit import Tensors, gradient_pullback, unit_steps
from ._rays import Vector
from ._two_view_problem import Problem, State


class Hessian(NamedTuple):
    """The exact second derivatives of the cost, with the points eliminated."""

    camera: Tensor  # (*B, m, m) reduced camera matrix
    mixed: Tensor  # (*B, 3, m, N) points by camera
    inverse: Tensor  # (*B, 3, 3, N) inverses of the blocks of the points

    def pull_points(self, g: Tensor) -> Tensor:
        """Return ``H_yy^-1 g`` for g ``(*B, 3, ..., N)``."""
        return torch.einsum("...ijn,...jn->...in", self.inverse, g)

    def solve(self, camera: Tensor, points: Tensor) -> Tensors:
        """Return ``H^-1 g`` for the parts of g, ``(*B, m)`` and ``(*B, 3, N)``."""
        own = self.pull_points(points)
        rest = camera - torch.einsum("...kmn,...kn->...m", self.mixed, own)
        step = torch.linalg.solve(self.camera, rest)
        back = torch.einsum("...kmn,...m->...kn", self.mixed, step)
        return step, own - self.pull_points(back)


class BundleObjective(NamedTuple):
    """Bundle adjustment over (R, t, log focal scales, points); steps are (camera, points)."""

    problem: Problem  # the data of the problem are replaced

    def zero(self, unknowns: Tensors) -> Tensors:
        _, t, _, y = unknowns
        camera = torch.zeros_like(t[..., :1]).repeat_interleave(self.problem.size, -1)
        return camera, torch.zeros_like(y)

    def move(self, unknowns: Tensors, step: Tensors) -> Tensors:
        camera, points = step
        moved = self.problem.move(from_unknowns(unknowns), camera, _vector(points))
        # torch.func.vjp fails inside jacrev where an output does not depend on the inputs.
        return to_unknowns(moved._replace(log_focal=moved.log_focal + 0 * camera[..., :1]))

    def cost(self, unknowns: Tensors, data: Tensors) -> Tensor:
        return self.problem.with_data(data).cost(from_unknowns(unknowns))

    def solve(self, product: Callable[..., Tensors], g: Tensors) -> Tensors:
        camera, points = g
        return _blocks(product, camera, points).solve(camera, points)


def hessian(state: State, problem: Problem) -> Hessian:
    """Return the blocks of the exact Hessian at a state."""
    objective, unknowns = BundleObjective(problem), to_unknowns(state)
    pullback = gradient_pullback(objective, unknowns, problem.data)
    camera, points = objective.zero(unknowns)
    return _blocks(lambda *step: pullback(step)[0], camera, points)


def _blocks(product: Callable[..., Tensors], camera: Tensor, points: Tensor) -> Hessian:
    """Compute the blocks from one product per camera unknown and three for all points."""
    m = camera.shape[-1]
    cameras = torch.cat((unit_steps(camera), camera.new_zeros(3, *camera.shape)))
    axes = unit_steps(points[..., 0])[..., None].expand(3, *points.shape)
    by_camera, by_point = torch.func.vmap(product)(
        cameras, torch.cat((points.new_zeros(m, *points.shape), axes))
    )
    Hcc, Hyc = by_camera[:m].movedim(0, -1), by_point[:m].movedim(0, -2)
    inverse = _inverse3(by_point[m:].movedim(0, -2))
    eliminated = torch.einsum("...kln,...ljn->...kjn", inverse, Hyc)
    return Hessian(Hcc - torch.einsum("...kmn,...kjn->...mj", Hyc, eliminated), Hyc, inverse)


def to_unknowns(state: State) -> Tensors:
    """Return (R, t, log focal scales, points ``(*B, 3, N)``) of a state."""
    return state.R, state.t, state.log_focal, torch.stack(state.y, -2)


def from_unknowns(unknowns: Tensors) -> State:
    """Return the state of (R, t, log focal scales, points ``(*B, 3, N)``)."""
    R, t, log_focal, y = unknowns
    return State(R, t, log_focal, _vector(y))


def _vector(y: Tensor) -> Vector:
    u, v, w = y.unbind(-2)
    return u, v, w


def _inverse3(A: Tensor) -> Tensor:
    """Return the inverses of symmetric ``(*B, 3, 3, N)``, in closed form."""
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
