"""Refinement of a homography on its eight degrees of freedom: marginal loss of Sampson distances in
pixels."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..errors import InputError
from ._forward_mode import forward_mode
from .checks import check_matrices, check_points
from .kernels import hartley, squared_homography_sampson
from .losses import marginal_score, marginal_weight

_TOLERANCE = 1e-7  # of the score: the gain of a step at convergence
_DAMPING = (1e-6, 30.0)  # at the start, and the factor by which it grows when a step is refused
_LEAST_MATCHES = 8


class _State(NamedTuple):
    """Matches under a homography G of normalised coordinates; `square` in square pixels, infinite
    behind the camera."""

    residual: Tensor  # (N, 2)
    image: Tensor  # (N, 2) G x1
    depth: Tensor  # (N, 1) third homogeneous coordinate
    information: (
        Tensor  # (N, 2, 2) inverse covariance of the residual, for unit noise in both images
    )
    square: Tensor  # (N,)


def refine_homography(
    H: Tensor,
    x1: Tensor,
    x2: Tensor,
    weights: Tensor | None = None,
    *,
    threshold_px: float = 3.0,
    max_iterations: int = 15,
) -> Tensor:
    """The homography near H whose Sampson distances have the highest marginal score, by
    Levenberg-Marquardt.

    Matches beyond the threshold do not count, those within count less the farther they are; H may
    move until others come within.

    The maximum is differentiable by x1, x2 and weights (first derivatives, implicit function
    theorem, exact Hessian); the start has derivative zero.

    Args:
        H: (3, 3) ``x2 = H x1`` in pixels.
        x1, x2: (N, 2) pixels, float64.
        weights: (N,) of the squared distances, not negative.
        threshold_px: see :mod:`sfmkit.geometry.losses`.

    Returns:
        (3, 3) with ``H[2, 2] = 1``. H itself, so scaled, where fewer than 8 matches lie within the
        threshold.

    Raises:
        InputError: shapes, dtypes, NaN, a threshold that is not positive.

    Source: Hartley & Zisserman 4.2.6 (distance), A6.2 (iteration); the loss: Barath et al.,
    MAGSAC++, CVPR 2020.
    """
    check_points(0, weights, x1=x1, x2=x2)
    check_matrices(x1, H=H)
    given = (x1, x2, weights)
    H, x1, x2 = H.detach(), x1.detach(), x2.detach()
    weights = None if weights is None else weights.detach()
    if not threshold_px > 0:
        raise InputError(f"threshold_px must be positive pixels, not {threshold_px}")
    if len(x1) < _LEAST_MATCHES:
        return H / H[2, 2]
    (n1, T1), (n2, T2) = hartley(x1), hartley(x2)
    scale1, scale2 = T1[0, 0], T2[0, 0]
    G = T2 @ H @ torch.linalg.inv(T1)
    G = G / G[2, 2]
    h1 = torch.cat((n1, torch.ones_like(n1[:, :1])), 1)

    def state(G: Tensor) -> _State:
        y = h1 @ G.mT
        depth = y[:, 2:]
        image = y[:, :2] / depth
        A = (G[:2, :2] - image[:, :, None] * G[2:, :2]) / depth[:, :, None] * (scale1 / scale2)
        residual = n2 - image
        information = _inverse(torch.eye(2, dtype=G.dtype) + A @ A.mT)
        square = torch.einsum("ni,nij,nj->n", residual, information, residual) / scale2**2
        usable = square.isfinite() & (depth[:, 0] * depth.median().sign() > 0)
        return _State(residual, image, depth, information, torch.where(usable, square, torch.inf))

    def score(s: _State) -> float:
        each = marginal_score(s.square.clamp(max=threshold_px**2), threshold_px)
        return float((each if weights is None else each * weights).sum())

    now = state(G)
    best, damping = score(now), _DAMPING[0]
    for _ in range(max_iterations):
        near = now.square < threshold_px**2
        if int(near.sum()) < _LEAST_MATCHES:
            break
        weight = marginal_weight(now.square[near], threshold_px)
        N, b = _normal_equations(
            h1, now, near, weight if weights is None else weight * weights[near]
        )
        while True:
            step = torch.linalg.solve(N + damping * torch.diag(N.diagonal()), b)
            trial_G = G + torch.cat((step, step.new_zeros(1))).view(3, 3)
            trial = state(trial_G)
            gain = score(trial) - best
            if gain >= 0 or damping > 1e6:
                break
            damping *= _DAMPING[1]
        if gain < 0:
            break
        G, now, best, damping = trial_G, trial, best + gain, max(damping / 10, 1e-9)
        if gain <= _TOLERANCE * best:
            break
    H = torch.linalg.inv(T2) @ G @ T1
    H = H / H[2, 2]
    if torch.is_grad_enabled() and any(a is not None and a.requires_grad for a in given):
        return _attach_derivatives(H, *given, threshold_px)
    return H


def _attach_derivatives(
    H: Tensor, x1: Tensor, x2: Tensor, weights: Tensor | None, threshold_px: float
) -> Tensor:
    """One exact Newton step from the maximum, recorded through the data only: first derivatives are
    right."""
    (_, T1), (_, T2) = (
        hartley(x1.detach()),
        hartley(x2.detach()),
    )  # coordinates in which the Hessian is benign
    G = T2 @ H @ torch.linalg.inv(T1)
    corner = G[2, 2]
    free = (G / corner).flatten()[:8]

    def cost(g: Tensor, x1: Tensor, x2: Tensor, weights: Tensor | None) -> Tensor:
        G = torch.cat((g, g.new_ones(1))).view(3, 3)
        square = squared_homography_sampson(torch.linalg.inv(T2) @ G @ T1, x1, x2)
        each = marginal_score(square.clamp(max=threshold_px**2), threshold_px)
        return -(each if weights is None else each * weights).sum()

    gradient = torch.func.grad(cost)
    fixed = [None if a is None else a.detach() for a in (x1, x2, weights)]
    with forward_mode():
        hessian = torch.func.jacfwd(gradient)(free, *fixed)
    step = -torch.linalg.pinv(hessian, rtol=1e-14) @ gradient(free, x1, x2, weights)
    H = torch.linalg.inv(T2) @ torch.cat((free + step, free.new_ones(1))).view(3, 3) @ T1
    return H / H[2, 2]


def _inverse(S: Tensor) -> Tensor:
    """(N, 2, 2) inverses; not finite, instead of an error, where a point is sent to infinity."""
    a, b, c, d = S.flatten(1).unbind(1)
    return torch.stack((d, -b, -c, a), -1).unflatten(-1, (2, 2)) / (a * d - b * c)[:, None, None]


def _normal_equations(h1: Tensor, s: _State, near: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """(8, 8) and (8,) of the weighted least squares in the entries of G but the last."""
    a = h1[near] / s.depth[near]
    zero = torch.zeros_like(a)
    u, v = s.image[near, :1], s.image[near, 1:]
    J = torch.stack((torch.cat((a, zero, -u * a), 1), torch.cat((zero, a, -v * a), 1)), 1)[:, :, :8]
    WJ = (s.information[near] * weight[:, None, None]) @ J
    return J.flatten(0, 1).mT @ WJ.flatten(0, 1), WJ.flatten(0, 1).mT @ s.residual[near].flatten()
