"""Refinement of a relative pose together with unknown focal lengths, without points.

The cost is that of :mod:`.refinement`. In normalised coordinates of the initial intrinsics, the
focal factors s1 and s2 turn the essential matrix into ``M = D2^-1 [t]x R D1^-1`` with
``D = diag(s, s, 1)``, so residuals and their derivatives with respect to the nine entries of M are
those of an essential matrix; only the tangent space has one or two more dimensions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from ..errors import InputError
from ._implicit import Tensors, attach_derivatives, is_differentiated, solve_dense
from ._levenberg_marquardt import Minimised, Schedule, Trial, levenberg_marquardt
from .checks import check_intrinsics, check_points
from .lie import hat, so3_exp, sphere_exp, tangent_basis
from .loss_kernels import Loss, LossTerms, loss_terms
from .pose import check_pose
from .refinement import Bearings, _linearise, _Residual, _residual, _total, bearings

FreeFocal = Literal["shared", "first", "second", "separate"]
# log factors of both cameras = matrix @ unknowns
_UNKNOWNS: dict[FreeFocal, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "shared": ((1.0,), (1.0,)),
    "first": ((1.0,), (0.0,)),
    "second": ((0.0,), (1.0,)),
    "separate": ((1.0, 0.0), (0.0, 1.0)),
}

_TOLERANCE = 1e-14  # of the cost: the predicted decrease at convergence
_EXACT = 1e-24  # square pixels per match: rounding of the residuals
_DAMPING = 1e-6  # at the start
_POLISH = 6  # steps before derivatives are taken: a focal length lies in a flat valley
_LONGEST = 0.7  # of the logarithm of a focal length in one step: it is exponential in the unknown


def focal_unknowns(focal: FreeFocal, like: Tensor) -> Tensor:
    """Return the matrix (2, k) that maps k unknowns to the logarithms of both focal factors.

    Raises:
        InputError: `focal` is unknown.
    """
    if focal not in _UNKNOWNS:
        raise InputError(f"focal must be one of {', '.join(_UNKNOWNS)}, not {focal!r}")
    return torch.tensor(_UNKNOWNS[focal], dtype=like.dtype, device=like.device)


@dataclass(frozen=True, eq=False)
class FocalRefinement:
    """A relative pose and focal lengths at a minimum of the robust Sampson distances.

    Attributes:
        R: (*B, 3, 3) rotation.
        t: (*B, 3) unit translation, ``X2 = R X1 + t``.
        scale: (*B, 2) factors of the focal lengths in K1 and in K2.
        cost: (*B, iterations + 1) half the weighted loss, square pixels.
        iterations: (*B,) int64 number of linearisations until convergence.
        converged: (*B,) bool, whether the iterations converged.
    """

    R: Tensor
    t: Tensor
    scale: Tensor
    cost: Tensor
    iterations: Tensor
    converged: Tensor


def refine_focal(
    R: Tensor,
    t: Tensor,
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    weights: Tensor | None = None,
    *,
    scale: Tensor | None = None,
    focal: FreeFocal = "shared",
    loss: Loss = "cauchy",
    loss_scale: float = 0.5,
    max_iterations: int = 50,
) -> FocalRefinement:
    """Minimise the robust Sampson distances over the pose and the unknown focal lengths.

    The minimum is differentiable with respect to x1, x2, weights, K1 and K2, like that of
    :func:`~sfmkit.geometry.refinement.refine_essential`. Where the matches do not determine the
    focal length, it moves far along a flat valley: check the covariance
    (:func:`~sfmkit.geometry.block_covariance.linearise_pose` with `focal`).

    Args:
        R, t: (*B, 3, 3), (*B, 3) initial pose; the length of t does not matter.
        x1, x2: (*B, N, 2) undistorted pixels, N >= 7.
        K1, K2: (3, 3) or (*B, 3, 3); principal points, ratio of the focal lengths and skew stay.
        weights: (*B, N) or (N,) non-negative weights of the matches.
        scale: (*B, 2) initial factors of the focal lengths, ones by default; that of a known camera
            stays.
        focal: Unknown focal lengths: ``shared`` (one factor for both cameras), ``first`` or
            ``second`` (of one camera) or ``separate`` (two factors).
        loss, loss_scale: Loss and its scale in pixels, see
            :func:`sfmkit.geometry.losses.loss_terms`.
        max_iterations: Largest number of linearisations.

    Raises:
        InputError: Shapes, dtypes or devices do not match, a value is not finite, t is zero, or
            `focal` is unknown.
        DegenerateGeometryError: There are fewer than 7 matches.
    """
    check_points(7, weights, x1=x1, x2=x2)
    check_intrinsics(x1, K1=K1, K2=K2)
    check_pose(R, t, like=x1)
    if not loss_scale > 0:
        raise InputError(f"loss_scale must be positive (pixels), not {loss_scale}")
    dtype = x1.dtype
    P = focal_unknowns(focal, x1.double())
    matches = bearings(x1, x2, K1, K2, weights)
    fixed = Bearings(*(None if a is None else a.detach() for a in matches))  # type: ignore[arg-type]
    objective = _FocalObjective(loss, loss_scale, P)
    try:
        batch = torch.broadcast_shapes(
            x1.shape[:-2], K1.shape[:-2], K2.shape[:-2], R.shape[:-2], t.shape[:-1]
        )
    except RuntimeError:
        raise InputError("the batch shapes of R, t, x1, K1 and K2 do not fit each other") from None
    R = R.detach().double().expand(*batch, 3, 3)
    t = torch.nn.functional.normalize(t.detach().double(), dim=-1).expand(*batch, 3)
    ones = torch.ones(2, dtype=R.dtype, device=R.device) if scale is None else scale
    log_scale = ones.detach().double().log().expand(*batch, 2)
    differentiated = max_iterations > 0 and is_differentiated(matches)
    polish = _POLISH if differentiated else 0
    found = _minimise(R, t, log_scale, fixed, objective, max_iterations, polish)
    R, t, log_scale = found.state.R, found.state.t, found.state.log_scale
    if differentiated:
        if matches.weights is None:
            matches = matches._replace(weights=torch.ones_like(matches.h1[..., 0, :]))
        R, t, log_scale = attach_derivatives(objective, (R, t, log_scale), tuple(matches))  # type: ignore[arg-type]
    return FocalRefinement(
        R.to(dtype),
        t.to(dtype),
        log_scale.exp().to(dtype),
        found.history.to(dtype),
        found.iterations,
        found.converged,
    )


class _FocalObjective(NamedTuple):
    """The loss, and the minimisation over (R, t, log factors) for :mod:`._implicit`."""

    loss: Loss
    scale: float
    unknowns: Tensor  # (2, k)

    def terms(self, square: Tensor) -> LossTerms:
        return loss_terms(self.loss, square, self.scale)

    def zero(self, unknowns: Tensors) -> Tensors:
        size = 5 + self.unknowns.shape[1]
        return (torch.zeros_like(unknowns[1][..., :1]).repeat_interleave(size, -1),)

    def move(self, unknowns: Tensors, step: Tensors) -> Tensors:
        (R, t, log_scale), (d,) = unknowns, step
        turn = (tangent_basis(t) @ d[..., 3:5, None]).squeeze(-1)
        moved = log_scale + (self.unknowns @ d[..., 5:, None]).squeeze(-1)
        return so3_exp(d[..., :3]) @ R, sphere_exp(t, turn), moved

    def cost(self, unknowns: Tensors, data: Tensors) -> Tensor:
        m = Bearings(*data)
        return _total(self.terms(_residual(_matrix(*unknowns), m).r ** 2), m)

    def solve(self, product: Callable[..., Tensors], g: Tensors) -> Tensors:
        return solve_dense(product, g)


def _inverse_factors(log_scale: Tensor) -> Tensor:
    """Return the diagonals of D1^-1 and D2^-1, (*B, 2, 3)."""
    small = (-log_scale).exp()
    return torch.stack((small, small, torch.ones_like(small)), -1)


def _matrix(R: Tensor, t: Tensor, log_scale: Tensor) -> Tensor:
    """Return ``D2^-1 [t]x R D1^-1``, (*B, 3, 3)."""
    D = _inverse_factors(log_scale)
    return D[..., 1, :, None] * (hat(t) @ R) * D[..., 0, None, :]


def _tangent(R: Tensor, t: Tensor, log_scale: Tensor, unknowns: Tensor) -> Tensor:
    """Return the derivative (*B, 9, 5 + k) of the matrix with respect to pose and factors."""
    D = _inverse_factors(log_scale)
    left, right = D[..., 1, None, :, None], D[..., 0, None, None, :]
    eye = torch.eye(3, dtype=R.dtype, device=R.device)
    turned = hat(t)[..., None, :, :] @ hat(eye) @ R[..., None, :, :]
    moved = hat(tangent_basis(t).mT) @ R[..., None, :, :]
    pose = left * torch.cat((turned, moved), -3) * right
    M = _matrix(R, t, log_scale)
    upper = torch.tensor([1.0, 1.0, 0.0], dtype=R.dtype, device=R.device)
    by_factor = torch.stack((-M * upper, -upper[:, None] * M), -3)
    by_factor = torch.einsum("ck,...cij->...kij", unknowns, by_factor)
    return torch.cat((pose, by_factor), -3).flatten(-2).mT


class _Evaluated(NamedTuple):
    R: Tensor
    t: Tensor
    log_scale: Tensor
    residual: _Residual
    terms: LossTerms


def _evaluate(unknowns: Tensors, m: Bearings, objective: _FocalObjective) -> _Evaluated:
    R, t, log_scale = unknowns
    residual = _residual(_matrix(R, t, log_scale), m)
    return _Evaluated(R, t, log_scale, residual, objective.terms(residual.r**2))


def _minimise(
    R: Tensor,
    t: Tensor,
    log_scale: Tensor,
    m: Bearings,
    objective: _FocalObjective,
    max_iterations: int,
    polish: int = 0,
) -> Minimised[_Evaluated]:
    """Minimise from (R, t, log factors), without checks and derivatives."""

    def propose(now: _Evaluated, damping: Tensor, near: Tensor) -> Trial[_Evaluated]:
        by_entry, matrix = _linearise(now.residual, now.terms, m, near)
        G = _tangent(now.R, now.t, now.log_scale, objective.unknowns)
        g, H = (G.mT @ by_entry[..., None]), G.mT @ matrix @ G
        scaled = damping[..., None] * H.diagonal(dim1=-2, dim2=-1)
        H = H + torch.diag_embed(scaled + torch.finfo(H.dtype).tiny)
        step = -torch.linalg.solve_ex(H, g)[0]
        longest = step[..., 5:, :].abs().amax((-2, -1))[..., None, None]
        step = step * (_LONGEST / longest.clamp(min=_LONGEST))
        unknowns = objective.move((now.R, now.t, now.log_scale), (step.squeeze(-1),))
        trial = _evaluate(unknowns, m, objective)
        return Trial(trial, _total(trial.terms, m), -(step * g).sum((-2, -1)))

    start = _evaluate((R, t, log_scale), m, objective)
    schedule = Schedule(
        max_iterations, _TOLERANCE, _EXACT * m.h1.shape[-1], _DAMPING, polish=polish
    )
    return levenberg_marquardt(start, _total(start.terms, m), propose, schedule)
