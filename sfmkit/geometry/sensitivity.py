"""Which matches a pose hangs on: its derivative by every match, and what dropping a match would do
to it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ._implicit import hessian
from ._two_view_problem import Jacobian, jacobian, linearise, weigh
from .bundle import TwoViewBundle


def pose_sensitivity(bundle: TwoViewBundle) -> Tensor:
    """The derivative of the pose by each match, ``(*B, N, 5, 4)``, radians per pixel.

    Rows: rotation vector (axes of camera 2) and the two tangent coordinates of t, as in
    :class:`Uncertainty`; columns: x1, y1, x2, y2. Exact at the minimum (implicit function theorem
    with the exact Hessian), for all matches at once and linear in N; what autograd through
    :func:`bundle_adjust` gives one output at a time.
    """
    state, problem = bundle.state(), bundle.problem()
    H = hessian(state, problem)
    J = jacobian(state, problem)
    camera, point, r = _rows(J)
    loss = problem.loss_terms(J.residual1, J.residual2)
    follow = torch.einsum("...kln,...lmn->...kmn", H.inverse, H.mixed)
    D = camera - torch.einsum("...rkn,...kmn->...rmn", point, follow)
    # The gradient of the loss by the residual, slope r, itself changes by slope + 2 curvature r
    # r^T.
    along = 2 * loss.curvature[..., None, :] * torch.einsum("...rn,...rmn->...mn", r, D)
    D = problem.weights[..., None, None, :] * (
        loss.slope[..., None, None, :] * D + r[..., :, None, :] * along[..., None, :, :]
    )
    return torch.linalg.solve(H.camera[..., None, :, :], D.movedim(-1, -3).mT)[..., :5, :]


@dataclass(frozen=True, eq=False)
class Influence:
    """What each match does for the pose.

    Attributes:
        change: ``(*B, N, 5)`` how the pose would move if the match were dropped, radians, (rotation
            vector, t's tangent).
        leverage: ``(*B, N)`` share of its own residual that a match decides, in [0, 1]; they sum to
            the number of camera unknowns. High leverage: the pose follows this match whatever the
            others say.
        cook: ``(*B, N)`` Cook's distance, `change` in units of the pose's uncertainty, squared and
            per unknown; above about ``4 / N`` deserves a look.
    """

    change: Tensor
    leverage: Tensor
    cook: Tensor


def influence(bundle: TwoViewBundle) -> Influence:
    """The influence of each match on the pose, to first order and without refitting.

    Once its point is eliminated a match is one equation for the camera, so that the exact formulas
    of linear regression for leaving out one row apply to the linearised problem.

    Source: Cook, Detection of influential observations in linear regression, Technometrics 1977.
    """
    state, problem = bundle.state(), bundle.problem()
    system = linearise(state, problem)
    camera, _, r = _rows(weigh(jacobian(state, problem), problem))
    Z = system.Z[..., :-1, :, :]
    own = torch.einsum("...rjn,...rkn->...njk", camera, camera) - torch.einsum(
        "...jrn,...krn->...njk", Z, Z
    )
    leverage = torch.linalg.solve(system.S[..., None, :, :], own).diagonal(dim1=-2, dim2=-1).sum(-1)
    # The point absorbs the rest of the residual: at the minimum J_y^T r = 0.
    pull = torch.einsum("...rjn,...rn->...jn", camera, r)
    kept = 1 - leverage
    change = (
        torch.linalg.solve(system.S, pull).mT / torch.where(kept > 1e-9, kept, torch.inf)[..., None]
    )
    spread = torch.einsum("...nj,...jk,...nk->...n", change, system.S, change)
    variance = (r * r).sum((-1, -2)) / ((bundle.weights > 0).sum(-1) - problem.size).clamp_min(1)
    cook = spread / (problem.size * variance[..., None].clamp_min(torch.finfo(r.dtype).tiny))
    return Influence(change[..., :5], leverage, cook)


def _rows(J: Jacobian) -> tuple[Tensor, Tensor, Tensor]:
    """The Jacobian as tensors: camera ``(*B, 4, m, N)``, point ``(*B, 4, 3, N)``, residual
    ``(*B, 4, N)``."""
    zero = torch.zeros_like(J.residual1[0])
    none = (zero, zero)

    def rows(columns1: tuple, columns2: tuple) -> Tensor:
        return torch.stack(
            [
                torch.stack([(c or none)[i] + zero for c in columns], -2)
                for columns in (columns1, columns2)
                for i in range(2)
            ],
            -3,
        )

    return (
        rows(J.camera1, J.camera2),
        rows((*J.point1, None), J.point2),
        torch.stack((*J.residual1, *J.residual2), -2),
    )
