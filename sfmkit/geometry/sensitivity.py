"""The effect of each match on a pose: derivatives, and the change if it is left out."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ._bundle_implicit import hessian
from ._two_view_problem import Jacobian, Problem, State, jacobian, linearise, weigh
from .bundle import TwoViewBundle


def pose_sensitivity(bundle: TwoViewBundle) -> Tensor:
    """Return the derivative of the pose with respect to each match, ``(*B, N, 5, 4)``.

    The unit is radians per pixel. The rows are the rotation vector (axes of camera 2) and the two
    tangent coordinates of t, as in :class:`Uncertainty`; the columns are x1, y1, x2, y2. The
    derivative is exact at the minimum (implicit function theorem with the exact Hessian). It is
    computed for all matches at once in a time linear in N, whereas autograd through
    :func:`bundle_adjust` gives one output at a time.
    """
    state, problem = bundle.state(), bundle.problem()
    H = hessian(state, problem)
    J = jacobian(state, problem)
    camera, point, r = _rows(J)
    loss = problem.loss_terms(J.residual1, J.residual2)
    follow = torch.einsum("...kln,...lmn->...kmn", H.inverse, H.mixed)
    D = camera - torch.einsum("...rkn,...kmn->...rmn", point, follow)
    # The derivative of slope r, the gradient of the loss, is slope + 2 curvature r r^T.
    along = 2 * loss.curvature[..., None, :] * torch.einsum("...rn,...rmn->...mn", r, D)
    D = problem.weights[..., None, None, :] * (
        loss.slope[..., None, None, :] * D + r[..., :, None, :] * along[..., None, :, :]
    )
    found = torch.linalg.solve(H.camera[..., None, :, :], D.movedim(-1, -3).mT)[..., :5, :]
    return found.to(bundle.R.dtype)


@dataclass(frozen=True, eq=False)
class Influence:
    """The effect of each match on the pose.

    Attributes:
        change: ``(*B, N, 5)`` change of the pose if the match is left out, radians (rotation
            vector, tangent of t).
        leverage: ``(*B, N)`` share of its own residual that a match determines, in [0, 1]. The
            leverages add up to the number of camera unknowns. The pose follows a match of high
            leverage regardless of the other matches.
        cook: ``(*B, N)`` Cook's distance: the square of `change` in units of the uncertainty of the
            pose, divided by the number of unknowns. Values above about ``4 / N`` need attention.
    """

    change: Tensor
    leverage: Tensor
    cook: Tensor


def influence(bundle: TwoViewBundle) -> Influence:
    """Return the influence of each match on the pose, without refitting.

    `change` is one Newton step of the problem without the match, with the exact Hessian, which
    includes the curvature of the loss and of the projection. If a match is left out after the
    elimination of its point, one ``m x m`` term is subtracted from the reduced camera matrix.
    `leverage` is that of the weighted least-squares problem at the minimum.

    Source: Cook, Detection of influential observations in linear regression, Technometrics 1977;
    Pregibon, Logistic regression diagnostics, Annals of Statistics 1981 (the one-step change).
    """
    state, problem = bundle.state(), bundle.problem()
    system = linearise(state, problem)
    camera, _, r = _rows(weigh(jacobian(state, problem), problem))
    Z = system.Z[..., :-1, :, :]
    own = torch.einsum("...rjn,...rkn->...njk", camera, camera) - torch.einsum(
        "...jrn,...krn->...njk", Z, Z
    )
    leverage = torch.linalg.solve(system.S[..., None, :, :], own).diagonal(dim1=-2, dim2=-1).sum(-1)
    # The gradient of one match; the gradient with respect to its point is zero at the minimum.
    pull = torch.einsum("...rjn,...rn->...nj", camera, r)
    each = hessian(*_one_problem_per_match(state, problem)).camera
    rest = each.sum(-3, keepdim=True) - each
    change = torch.linalg.solve_ex(rest, pull[..., None])[0][..., 0]
    spread = torch.einsum("...nj,...jk,...nk->...n", change, system.S, change)
    variance = (r * r).sum((-1, -2)) / ((bundle.weights > 0).sum(-1) - problem.size).clamp_min(1)
    cook = spread / (problem.size * variance[..., None].clamp_min(torch.finfo(r.dtype).tiny))
    kind = bundle.R.dtype
    return Influence(change[..., :5].to(kind), leverage.to(kind), cook.to(kind))


def _one_problem_per_match(state: State, problem: Problem) -> tuple[State, Problem]:
    """Convert the problem to a batch ``(*B, N)`` of problems with one match each."""
    x1, x2, weights, K1, K2 = problem.data
    N = x1.shape[-2]
    R, t, log_focal = (
        a.unsqueeze(axis).expand(*a.shape[: axis + 1], N, *a.shape[axis + 1 :])
        for a, axis in ((state.R, -3), (state.t, -2), (state.log_focal, -2))
    )
    u, v, w = (a[..., None] for a in state.y)
    data = (x1[..., None, :], x2[..., None, :], weights[..., None], K1[..., None, :, :])
    each = problem.with_data((*data, K2[..., None, :, :]))
    return State(R, t, log_focal, (u, v, w)), each


def _rows(J: Jacobian) -> tuple[Tensor, Tensor, Tensor]:
    """Convert the Jacobian to tensors.

    Returns the camera part ``(*B, 4, m, N)``, the point part ``(*B, 4, 3, N)`` and the residual
    ``(*B, 4, N)``.
    """
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
