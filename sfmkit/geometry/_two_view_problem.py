"""The least-squares problem of two-view bundle adjustment.

The module computes residuals, Jacobians and the reduced camera system.

Camera unknowns: a rotation vector omega (``R <- exp(omega) R``), two tangent coordinates b of the
unit translation, and optionally the logarithm of one or two focal scales. Point unknowns:
``y = (u, v, rho)``, the direction and inverse depth in camera 1, ``X = (u, v, 1) / rho``. With
these, distant points are as well conditioned as near ones, and the projection in image 1 is (u, v).

Each match contributes a 3 x 3 block for its point, with the Cholesky factor L in closed form. The
elimination of the points (Schur complement) leaves the reduced camera system
``S = Jc^T Jc - Z^T Z``, ``Z = L^-1 Jy^T Jc``, which is at most 7 x 7. Its computation is linear in
the number of points.

Components ``(*B, N)`` are separate tensors as in ``_rays``; camera quantities have the shape
``(*B, 1)``.

Source: Triggs et al., Bundle adjustment - a modern synthesis, 2000, section 6.1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from ._rays import Vector, components, cross, dot, rotated_ray
from .lie import so3_exp, sphere_exp, tangent_basis
from .loss_kernels import Loss, LossTerms, loss_terms

Focal = Literal["fixed", "shared", "separate"]
Pair = tuple[Tensor, Tensor]

FREE_FOCALS: dict[Focal, int] = {"fixed": 0, "shared": 1, "separate": 2}


class State(NamedTuple):
    """The unknowns of the problem.

    R (*B, 3, 3), unit t (*B, 3), log focal scales (*B, 2) and points (u, v, rho).
    """

    R: Tensor
    t: Tensor
    log_focal: Tensor
    y: Vector


@dataclass(frozen=True, eq=False)
class Problem:
    """Observations (pixels, float64) and the loss of the residuals."""

    x1: Tensor
    x2: Tensor
    weights: Tensor
    K1: Tensor
    K2: Tensor
    loss: Loss
    scale: float
    focal: Focal

    @property
    def data(self) -> tuple[Tensor, ...]:
        """Return x1, x2, weights, K1 and K2."""
        return self.x1, self.x2, self.weights, self.K1, self.K2

    def detached(self) -> Problem:
        """Return the same problem without its autograd graph."""
        return self.with_data([a.detach() for a in self.data])

    def with_data(self, data: Sequence[Tensor]) -> Problem:
        """Return the same problem for other x1, x2, weights, K1 and K2."""
        x1, x2, weights, K1, K2 = data
        return Problem(x1, x2, weights, K1, K2, self.loss, self.scale, self.focal)

    def part(self, rows: slice) -> Problem:
        """Return the problem of some of the matches."""
        x1, x2 = self.x1[..., rows, :], self.x2[..., rows, :]
        return Problem(
            x1, x2, self.weights[..., rows], self.K1, self.K2, self.loss, self.scale, self.focal
        )

    @property
    def size(self) -> int:
        """Return the number of camera unknowns, 5 to 7."""
        return 5 + FREE_FOCALS[self.focal]

    def move(self, state: State, camera: Tensor, points: Vector | None = None) -> State:
        """Return the state after a camera step (*B, size) and a step of the points."""
        B = tangent_basis(state.t)
        u, v, w = state.y
        if points is not None:
            u, v, w = u + points[0], v + points[1], w + points[2]
        log_focal = state.log_focal
        if self.focal != "fixed":
            log_focal = log_focal + camera[..., 5:].expand(*camera.shape[:-1], 2)
        return State(
            so3_exp(camera[..., :3]) @ state.R,
            sphere_exp(state.t, (B @ camera[..., 3:5, None])[..., 0]),
            log_focal,
            (u, v, w),
        )

    def cost(self, state: State) -> Tensor:
        """Return half the weighted sum of the losses of all matches, (*B,)."""
        return _sum(
            0.5 * (p.weights * p.loss_terms(*residuals(s, p)).value).sum(-1)
            for s, p in in_chunks(state, self)
        )

    def loss_terms(self, r1: Pair, r2: Pair) -> LossTerms:
        """Return the loss of the squared residual of every match over both images, (*B, N)."""
        return loss_terms(self.loss, _dot2(r1, r1) + _dot2(r2, r2), self.scale)


class Linearised(NamedTuple):
    """The Gauss-Newton system at a state.

    The last of the size + 1 columns of Z belongs to the residual.
    """

    S: Tensor  # (*B, size, size) reduced camera matrix
    g: Tensor  # (*B, size) right-hand side, the gradient after the elimination of the points
    Z: Tensor  # (*B, size + 1, 3, N)
    L: tuple[Tensor, ...]  # l00, l10, l11, l20, l21, l22
    H: Tensor  # (*B, size, size) camera block before the elimination

    def solve_points(self, camera: Tensor) -> Vector:
        """Return the step of the points for a camera step (*B, size)."""
        one = torch.ones_like(camera[..., :1])
        rhs = (torch.cat((camera, one), -1)[..., None, :] @ self.Z.flatten(-2))[..., 0, :]
        a, b, c = rhs.unflatten(-1, (3, -1)).unbind(-2)
        return back_substitute(self.L, (-a, -b, -c))


def residuals(state: State, problem: Problem) -> tuple[Pair, Pair]:
    """Return projection minus observation in image 1 and image 2, pixels."""
    u, v, w = state.y
    f1, f2 = (f[..., None] for f in state.log_focal.exp().unbind(-1))
    px, py, pz = _in_camera2(state, rotated_ray(state.R, u, v))
    return _residual(problem.K1, f1, u, v, problem.x1), _residual(
        problem.K2, f2, px / pz, py / pz, problem.x2
    )


def _in_camera2(state: State, rotated: Vector) -> Vector:
    w, t = state.y[2], components(state.t)
    return rotated[0] + w * t[0], rotated[1] + w * t[1], rotated[2] + w * t[2]


def _residual(K: Tensor, f: Tensor, a: Tensor, b: Tensor, x: Tensor) -> Pair:
    fx, skew, cx, fy, cy = intrinsics(K)
    return f * (fx * a + skew * b) + (cx - x[..., 0]), f * fy * b + (cy - x[..., 1])


def intrinsics(K: Tensor) -> tuple[Tensor, ...]:
    """Return fx, skew, cx, fy and cy, each (*B, 1)."""
    return (
        K[..., 0, 0, None],
        K[..., 0, 1, None],
        K[..., 0, 2, None],
        K[..., 1, 1, None],
        K[..., 1, 2, None],
    )


class Jacobian(NamedTuple):
    """Derivatives of the pixels of all matches.

    Each column is a pair (x, y) of components; None stands for zero.
    """

    point1: tuple[Pair, Pair]  # image 1 with respect to u, v (rho has no effect)
    point2: tuple[Pair, Pair, Pair]  # image 2 with respect to u, v, rho
    camera1: tuple[Pair | None, ...]  # image 1 with respect to the camera unknowns
    camera2: tuple[Pair | None, ...]
    residual1: Pair
    residual2: Pair


def jacobian(state: State, problem: Problem) -> Jacobian:
    """Return the Jacobian and the residuals without weights."""
    u, v, w = state.y
    t = components(state.t)
    f1, f2 = (f[..., None] for f in state.log_focal.exp().unbind(-1))
    rotated = rotated_ray(state.R, u, v)
    px, py, pz = _in_camera2(state, rotated)
    inverse = 1 / pz
    a, b = px * inverse, py * inverse
    r1 = _residual(problem.K1, f1, u, v, problem.x1)
    r2 = _residual(problem.K2, f2, a, b, problem.x2)
    one, zero = torch.ones_like(u), torch.zeros_like(u)
    fx, skew, _, fy, _ = intrinsics(problem.K1)
    a11, a12, a22 = f1 * fx, f1 * skew, f1 * fy
    fx, skew, _, fy, _ = intrinsics(problem.K2)
    b11, b12, b22 = f2 * fx, f2 * skew, f2 * fy
    # Rows of d(pixel 2) / d(point in camera 2).
    row_x: Vector = (b11 * inverse, b12 * inverse, -(b11 * a + b12 * b) * inverse)
    row_y: Vector = (zero, b22 * inverse, -b22 * b * inverse)

    def seen(direction: Vector) -> Pair:
        return dot(row_x, direction), row_y[1] * direction[1] + row_y[2] * direction[2]

    B = tangent_basis(state.t)
    turned = zip(cross(rotated, row_x), cross(rotated, row_y))  # g . (omega x p) = omega . (p x g)
    shifted = (tuple(w * c for c in seen(components(B[..., k]))) for k in range(2))
    camera1: list[Pair | None] = [None] * 5
    camera2: list[Pair | None] = [*turned, *shifted]  # type: ignore[list-item]
    if problem.focal != "fixed":
        scaled1, scaled2 = (a11 * u + a12 * v, a22 * v), (b11 * a + b12 * b, b22 * b)
        camera1 += [scaled1] if problem.focal == "shared" else [scaled1, None]
        camera2 += [scaled2] if problem.focal == "shared" else [None, scaled2]
    return Jacobian(
        ((a11 * one, zero), (a12 * one, a22 * one)),
        (seen(components(state.R[..., 0])), seen(components(state.R[..., 1])), seen(t)),
        tuple(camera1),
        tuple(camera2),
        r1,
        r2,
    )


def weigh(J: Jacobian, problem: Problem) -> Jacobian:
    """Multiply the rows by the square roots of their weights.

    ``J^T r`` is then the robust gradient, and ``J^T J`` is an upper bound of the Hessian. Each
    match has one weight. Separate weights for the two images would shift the residual from one
    image to the other, and converge slowly.
    """
    root = (problem.weights * problem.loss_terms(J.residual1, J.residual2).slope).sqrt()

    def times(columns: tuple[Pair | None, ...]) -> tuple[Any, ...]:
        return tuple(None if c is None else (root * c[0], root * c[1]) for c in columns)

    return Jacobian(*(times(part) for part in J[:4]), *times(J[4:]))  # type: ignore[arg-type]


def in_chunks(state: State, problem: Problem) -> Iterator[tuple[State, Problem]]:
    """Yield parts of the problem whose intermediate tensors fit in the processor's cache."""
    n = problem.x1.shape[-2]
    if n <= _CHUNK:
        yield state, problem
        return
    for first in range(0, n, _CHUNK):
        rows = slice(first, min(first + _CHUNK, n))
        u, v, w = (a[..., rows] for a in state.y)
        yield state._replace(y=(u, v, w)), problem.part(rows)


_CHUNK = 65_536


def _sum(terms: Iterable[Tensor]) -> Tensor:
    first, *rest = terms
    return sum(rest, first)


def linearise(
    state: State, problem: Problem, damping: Tensor | None = None, near: Tensor | None = None
) -> Linearised:
    """Return the reduced camera system.

    The system is that of reweighted least squares: its quadratic is an upper bound of the cost, so
    the step decreases the cost. Where `near` (*B,) is true, the curvature of the loss is included,
    which converges faster, but only close to the minimum. With `damping` (*B,), the diagonal of the
    block of every point is scaled by 1 + damping.
    """
    S, g, Z, L, H = zip(*(_linearise(s, p, damping, near) for s, p in in_chunks(state, problem)))
    if len(S) == 1:
        return Linearised(S[0], g[0], Z[0], L[0], H[0])
    return Linearised(
        _sum(S),
        _sum(g),
        torch.cat(Z, -1),
        tuple(torch.cat(entry, -1) for entry in zip(*L)),
        _sum(H),
    )


def _linearise(
    state: State, problem: Problem, damping: Tensor | None, near: Tensor | None
) -> Linearised:
    plain = jacobian(state, problem)
    J = weigh(plain, problem)
    L = _point_factor(J, 0.0 if damping is None else damping[..., None])
    columns1 = (*J.camera1, J.residual1)
    columns2 = (*J.camera2, J.residual2)
    Z = torch.stack(
        [torch.stack(_whiten(L, _onto_point(J, c1, c2)), -2) for c1, c2 in zip(columns1, columns2)],
        -3,
    )
    H = _gram(columns1) + _gram(columns2)
    flat = Z.flatten(-2)
    m = problem.size
    reduced, H = H - flat @ flat.mT, H[..., :m, :m]
    S = reduced[..., :m, :m]
    if near is not None and problem.loss != "squared":
        # At the minimum with respect to the points, J_y^T r = 0: the curvature along the residual
        # affects only the camera.
        bend = (
            2
            * problem.weights
            * problem.loss_terms(plain.residual1, plain.residual2).curvature
            * near[..., None]
        )
        along = torch.stack(
            [_onto_residual(plain, c1, c2) for c1, c2 in zip(plain.camera1, plain.camera2)], -2
        )
        S = S + (along * bend[..., None, :]) @ along.mT
    return Linearised(S, reduced[..., :m, m], Z, L, H)


def settle_points(state: State, problem: Problem, damping: Tensor) -> State:
    """Take one step of the points alone, with fixed cameras."""
    settled = []
    for s, p in in_chunks(state, problem):
        J = weigh(jacobian(s, p), p)
        L = _point_factor(J, damping[..., None])
        a, b, c = _whiten(L, _onto_point(J, J.residual1, J.residual2))
        settled.append([y + step for y, step in zip(s.y, back_substitute(L, (-a, -b, -c)))])
    u, v, w = (torch.cat(parts, -1) for parts in zip(*settled))
    return state._replace(y=(u, v, w))


def _onto_residual(J: Jacobian, c1: Pair | None, c2: Pair | None) -> Tensor:
    """Return ``r^T c`` for one column of the camera Jacobian."""
    one = 0.0 if c1 is None else _dot2(J.residual1, c1)
    two = 0.0 if c2 is None else _dot2(J.residual2, c2)
    return one + two + torch.zeros_like(J.residual1[0])


def _point_factor(J: Jacobian, damping: Tensor | float) -> tuple[Tensor, ...]:
    """Return the Cholesky factor of the 3 x 3 block of every point."""
    (au, av), (pu, pv, pw) = J.point1, J.point2
    grow = 1 + damping
    uu, vv, ww = _dot2(pu, pu) + _dot2(au, au), _dot2(pv, pv) + _dot2(av, av), _dot2(pw, pw)
    uv, uw, vw = _dot2(pu, pv) + _dot2(au, av), _dot2(pu, pw), _dot2(pv, pw)
    l00 = (grow * uu).clamp_min(_TINY).sqrt()
    l10, l20 = uv / l00, uw / l00
    l11 = (grow * vv - l10 * l10).clamp_min(_TINY).sqrt()
    l21 = (vw - l20 * l10) / l11
    # The block of a point on the epipole, or in the flat part of a redescending loss, is singular.
    # With this lower bound, the point does not move.
    l22 = (grow * ww - l20 * l20 - l21 * l21).clamp_min(_TINY).sqrt()
    return l00, l10, l11, l20, l21, l22


_TINY = 1e-24


def _onto_point(J: Jacobian, c1: Pair | None, c2: Pair | None) -> Vector:
    """Return ``Jy^T c`` for one column of the camera Jacobian."""
    terms: list[list[Tensor]] = [[], [], []]
    if c1 is not None:
        for k in range(2):
            terms[k].append(_dot2(J.point1[k], c1))
    if c2 is not None:
        for k in range(3):
            terms[k].append(_dot2(J.point2[k], c2))
    zero = torch.zeros_like(J.residual1[0])
    u, v, w = (sum(term[1:], term[0]) if term else zero for term in terms)
    return u, v, w


def _whiten(L: tuple[Tensor, ...], h: Vector) -> Vector:
    """Return ``L^-1 h``."""
    l00, l10, l11, l20, l21, l22 = L
    z0 = h[0] / l00
    z1 = (h[1] - l10 * z0) / l11
    return z0, z1, (h[2] - l20 * z0 - l21 * z1) / l22


def back_substitute(L: tuple[Tensor, ...], z: Vector) -> Vector:
    """Return ``L^-T z``."""
    l00, l10, l11, l20, l21, l22 = L
    w = z[2] / l22
    v = (z[1] - l21 * w) / l11
    return (z[0] - l10 * v - l20 * w) / l00, v, w


def _gram(columns: tuple[Pair | None, ...]) -> Tensor:
    """Return all inner products between the columns of one image."""
    zero = torch.zeros_like(next(c for c in columns if c is not None)[0])
    J = torch.stack(
        [torch.stack(torch.broadcast_tensors(*(c or (zero, zero))), -2) for c in columns], -3
    ).flatten(-2)
    return J @ J.mT


def _dot2(a: Pair, b: Pair) -> Tensor:
    return a[0] * b[0] + a[1] * b[1]
