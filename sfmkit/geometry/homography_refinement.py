"""Refinement of the eight degrees of freedom of a homography with a marginal loss.

The squared distance of a match is the first-order distance ``r^T (I + A A^T)^-1 r``, where r is the
residual in image 2 and A the derivative of the transfer with respect to x1. The Sampson distance
(:func:`sfmkit.geometry.homography.squared_homography_sampson_distance`) linearises the two
algebraic equations of Hartley and Zisserman instead. The two differ by terms of third order in r.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError
from ._implicit import Tensors, attach_derivatives, is_differentiated, solve_dense
from ._levenberg_marquardt import Minimised, Schedule, Trial, levenberg_marquardt
from .checks import _traced, check_matrices, check_points, check_scale
from .coordinates import to_homogeneous
from .kernels import hartley
from .loss_kernels import LossTerms, loss_terms

_TOLERANCE = 1e-12  # share of the cost: the predicted gain at convergence
_EXACT = 1e-24  # square pixels per match: rounding of the residuals
_DAMPING = (1e-6, 10.0)  # initial value, and the factor by which it changes
_POLISH = 3  # steps; each leaves about a hundredth of the error
_LEAST_MATCHES = 8
_HORIZON = 1e-9  # lower bound of the depth (about 1 elsewhere): keeps points on the horizon finite


def refine_homography(
    H: Tensor,
    x1: Tensor,
    x2: Tensor,
    weights: Tensor | None = None,
    *,
    threshold_px: float = 3.0,
    max_iterations: int = 15,
) -> Tensor:
    """Minimise the marginal loss of the first-order distances of a homography.

    The Levenberg-Marquardt algorithm starts from H. Matches beyond the threshold have no weight;
    the weight of the other matches decreases with their distance. As H changes, further matches
    can come within the threshold.

    The minimum is differentiable with respect to x1, x2 and weights, in reverse and forward mode
    and more than once (implicit function theorem, exact Hessian). The derivative with respect to
    the initial H is zero.

    Args:
        H: ``(*B, 3, 3)`` initial homography, ``x2 = H x1`` in pixels.
        x1, x2: ``(*B, N, 2)`` pixels.
        weights: ``(*B, N)`` or ``(N,)`` weights of the squared distances, not negative.
        threshold_px: Threshold of the marginal loss; see :mod:`sfmkit.geometry.losses`.
        max_iterations: Maximum number of iterations.

    Returns:
        ``(*B, 3, 3)`` with ``H[2, 2] = 1``. If fewer than 8 matches lie within the threshold, the
        result is the initial H, scaled, and its derivative is zero.

    Raises:
        InputError: Shapes or dtypes do not fit, a value is NaN, or the threshold is outside 1e-100
            to 1e100.
        DegenerateGeometryError: The squares of the coordinates overflow.

    Source: Hartley & Zisserman 4.2.6 (distance), A6.2 (iteration); the loss: Barath et al.,
    MAGSAC++, CVPR 2020.
    """
    check_points(0, weights, x1=x1, x2=x2)
    check_matrices(x1, H=H)
    check_scale(threshold_px=threshold_px)
    batch = torch.broadcast_shapes(H.shape[:-2], x1.shape[:-2])
    dtype = x1.dtype
    H = H.detach().double().expand(*batch, 3, 3)
    x1, x2 = (x.double().expand(*batch, *x.shape[-2:]) for x in (x1, x2))
    w = torch.ones_like(x1[..., 0]) if weights is None else weights.double()
    if x1.shape[-2] < _LEAST_MATCHES or max_iterations < 1:
        return (H / H[..., 2:, 2:]).to(dtype)
    # Hartley's coordinates are constants of the problem: the minimum does not depend on them.
    (_, T1), (_, T2) = hartley(x1.detach()), hartley(x2.detach())
    if not _traced() and not bool((T1[..., 0, 0] * T2[..., 0, 0]).all()):
        raise DegenerateGeometryError(
            "the squares of these coordinates are outside the range of floats; scale them"
        )
    G = T2 @ H @ torch.linalg.inv(T1)
    objective = _Objective(T1, T2, threshold_px)
    start = objective.evaluate(G / G[..., 2:, 2:], x1.detach(), x2.detach())
    enough = (start.square < threshold_px**2).sum(-1) >= _LEAST_MATCHES
    w = w * enough[..., None]  # no weight, no derivative
    differentiated = is_differentiated((x1, x2, w))
    data = (x1.detach(), x2.detach(), w.detach())
    polish = _POLISH if differentiated else 0
    found = _minimise(start, objective, data, enough, max_iterations, polish)
    G = found.state.G
    if differentiated:
        (G,) = attach_derivatives(objective, (G,), (x1, x2, w))
    H = torch.linalg.inv(T2) @ G @ T1
    return (H / H[..., 2:, 2:]).to(dtype)


class _Evaluated(NamedTuple):
    """The residuals of all matches for a homography G of normalised coordinates."""

    G: Tensor  # (*B, 3, 3)
    h1: Tensor  # (*B, N, 3) homogeneous normalised points of image 1
    image: Tensor  # (*B, N, 2) G h1
    depth: Tensor  # (*B, N) third homogeneous coordinate
    A: Tensor  # (*B, N, 2, 2) derivative of the image with respect to x1, in the scale of image 2
    root: Tensor  # (*B, N, 2, 2) lower Cholesky factor of I + A A^T
    residual: Tensor  # (*B, N, 2) in image 2
    scale: Tensor  # (*B, 1) normalised units of image 2 per pixel
    ratio: Tensor  # (*B, 1) scale of image 1 divided by that of image 2
    square: Tensor  # (*B, N) Sampson distance, square pixels; infinite behind the camera
    terms: LossTerms


class _Objective(NamedTuple):
    """The marginal loss, and the minimisation over G for :mod:`._implicit`."""

    T1: Tensor
    T2: Tensor
    threshold: float

    def evaluate(self, G: Tensor, x1: Tensor, x2: Tensor) -> _Evaluated:
        h1 = to_homogeneous(x1) @ self.T1.mT
        n2 = (to_homogeneous(x2) @ self.T2.mT)[..., :2]
        scale = self.T2[..., :1, 0]
        ratio = self.T1[..., :1, 0] / scale
        y = h1 @ G.mT
        depth = torch.where(y[..., 2].abs() < _HORIZON, _HORIZON, y[..., 2])
        image = y[..., :2] / depth[..., None]
        A = G[..., None, :2, :2] - image[..., :, None] * G[..., None, 2:, :2]
        A = A * (ratio / depth)[..., None, None]
        residual = n2 - image
        root = _cholesky2(A)
        u, v = _whiten(root, residual)
        square = (u * u + v * v) / scale**2
        usable = square.isfinite() & (depth * depth.detach().median(-1, keepdim=True)[0] > 0)
        square = torch.where(usable, square, torch.inf)
        terms = loss_terms("marginal", square.clamp(max=self.threshold**2), self.threshold)
        parts = (G, h1, image, depth, A, root, residual, scale, ratio, square, terms)
        return _Evaluated(*parts)

    def zero(self, unknowns: Tensors) -> Tensors:
        return (torch.zeros_like(unknowns[0].flatten(-2)[..., :8]),)

    def move(self, unknowns: Tensors, step: Tensors) -> Tensors:
        return (unknowns[0] + torch.nn.functional.pad(step[0], (0, 1)).unflatten(-1, (3, 3)),)

    def cost(self, unknowns: Tensors, data: Tensors) -> Tensor:
        x1, x2, w = data
        return _total(self.evaluate(unknowns[0], x1, x2), w)

    def solve(self, product: Callable[..., Tensors], g: Tensors) -> Tensors:
        return solve_dense(product, g)


def _total(e: _Evaluated, w: Tensor) -> Tensor:
    return 0.5 * (w * e.terms.value).sum(-1)


def _cholesky2(A: Tensor) -> Tensor:
    """Return the lower Cholesky factor of ``I + A A^T`` for ``(*B, N, 2, 2)``."""
    (a, b), (c, d) = (row.unbind(-1) for row in A.unbind(-2))
    l00 = (1 + a * a + b * b).sqrt()
    l10 = (a * c + b * d) / l00
    # The determinant 1 + |A|^2 + det(A)^2 is a sum of squares, so no digits cancel.
    l11 = (1 + a * a + b * b + c * c + d * d + (a * d - b * c) ** 2).sqrt() / l00
    zero = torch.zeros_like(l00)
    return torch.stack((torch.stack((l00, zero), -1), torch.stack((l10, l11), -1)), -2)


def _whiten(root: Tensor, r: Tensor) -> tuple[Tensor, Tensor]:
    """Return the components of ``root^-1 r``."""
    u = r[..., 0] / root[..., 0, 0]
    return u, (r[..., 1] - root[..., 1, 0] * u) / root[..., 1, 1]


def _minimise(
    start: _Evaluated,
    objective: _Objective,
    data: Tensors,
    enough: Tensor,
    max_iterations: int,
    polish: int,
) -> Minimised[_Evaluated]:
    x1, x2, w = data

    def propose(now: _Evaluated, damping: Tensor, near: Tensor) -> Trial[_Evaluated]:
        N, g = _linearise(now, w, near)
        scaled = damping[..., None] * N.diagonal(dim1=-2, dim2=-1)
        N = N + torch.diag_embed(scaled + torch.finfo(N.dtype).tiny)
        step = -torch.linalg.solve_ex(N, g[..., None])[0][..., 0]
        (G,) = objective.move((now.G,), (step,))
        trial = objective.evaluate(G, x1, x2)
        count = (trial.square < objective.threshold**2).sum(-1)
        cost = torch.where(count >= _LEAST_MATCHES, _total(trial, w), torch.inf)
        return Trial(trial, cost, -(step * g).sum(-1))

    floor = _EXACT * x1.shape[-2]
    schedule = Schedule(max_iterations, _TOLERANCE, floor, *_DAMPING, polish=polish)
    return levenberg_marquardt(start, _total(start, w), propose, schedule, converged=~enough)


def _linearise(e: _Evaluated, w: Tensor, near: Tensor) -> tuple[Tensor, Tensor]:
    """Return the robust Gauss-Newton matrix ``(*B, 8, 8)`` and the exact gradient ``(*B, 8)``.

    With ``S = I + A A^T``, ``z = S^-1 r`` and ``a = A^T z``, the derivative of ``r^T S^-1 r / 2``
    is ``-z^T d(image + A a)`` with constant a: the Jacobian at the corrected point of image 1.
    """
    u, v = _whiten(e.root, e.residual)
    z1 = v / e.root[..., 1, 1]
    z0 = (u - e.root[..., 1, 0] * z1) / e.root[..., 0, 0]
    a = (e.A.mT @ torch.stack((z0, z1), -1)[..., None])[..., 0]
    shift = (e.A @ a[..., None])[..., 0]
    inverse = 1 / e.depth[..., None]
    h = e.h1 * inverse
    ka = a * (e.ratio * inverse[..., 0])[..., None]
    c = (ka * e.G[..., None, 2, :2]).sum(-1, keepdim=True)
    corrected = (1 - c) * h + torch.nn.functional.pad(ka, (0, 1))
    zero = torch.zeros_like(corrected)
    last = (
        -e.image[..., :, None] * corrected[..., None, :2] - shift[..., :, None] * h[..., None, :2]
    )
    J0 = torch.cat((corrected, zero, last[..., 0, :]), -1)
    J1 = torch.cat((zero, corrected, last[..., 1, :]), -1)
    U0, U1 = _whiten(e.root[..., None, :, :], torch.stack((J0, J1), -1))
    p = u[..., None] * U0 + v[..., None] * U1  # minus the gradient of half the squared distance
    square_px = 1 / e.scale**2
    slope, curvature = w * e.terms.slope * square_px, w * e.terms.curvature * square_px**2
    curvature = torch.where(near[..., None], 2 * curvature, 0.0)
    U = torch.stack((U0, U1, p), -2).flatten(-3, -2)
    weight = torch.stack((slope, slope, curvature), -1).flatten(-2)
    return (U * weight[..., None]).mT @ U, -(p * slope[..., None]).sum(-2)
