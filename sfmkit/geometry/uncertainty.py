"""Uncertainty of a pose and its points.

Covariances are computed from the Jacobians at the minimum, the noise level from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError
from ._two_view_problem import Linearised, Problem, State, linearise, residuals
from .bundle import TwoViewBundle
from .checks import _traced, check_matrices


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances to first order in the noise.

    Attributes:
        pose: ``(*B, 5, 5)`` covariance of ``(omega, b)``: the rotation vector in radians, in the
            axes of camera 2 (truth = ``exp(omega) R``), and the direction of the translation in
            radians, along the two columns of ``tangent_basis(t)``. Free focal lengths are
            marginalised.
        points: ``(*B, N, 3, 3)`` covariances of the points in the frame of camera 1, in squared
            baselines, including the uncertainty of the pose; infinite for points at infinity.
        sigma_px: ``(*B,)`` estimated standard deviation of a pixel coordinate of unit weight.
        degrees_of_freedom: ``(*B,)`` number of matches minus the number of camera unknowns, from
            which `sigma_px` is estimated.
    """

    pose: Tensor
    points: Tensor
    sigma_px: Tensor
    degrees_of_freedom: Tensor

    @property
    def sigma_deg(self) -> Tensor:
        """Return the standard deviations ``(*B, 2)`` in degrees; see :func:`sigma_degrees`."""
        return sigma_degrees(self.pose)


def covariance(bundle: TwoViewBundle) -> Uncertainty:
    """Return the covariance of the pose and of every point of a two-view bundle adjustment.

    A match has four coordinates and its point three unknowns, so each match leaves one residual,
    and N matches leave ``N - 5`` degrees of freedom (fewer with free focal lengths), from which the
    noise is estimated. The covariance is correct for Gaussian noise with one variance (divided by
    the weights) that is small enough for a first-order approximation: an ellipsoid does not
    describe the error of a point whose relative depth error exceeds a fifth. If matches were
    removed because of their residuals, the noise is underestimated. For a robust loss, the noise
    estimate includes Huber's correction for M-estimators.

    The result is differentiable with respect to the data of the bundle adjustment.

    Raises:
        DegenerateGeometryError: There are no more matches than unknowns, or they do not determine
            the pose. Inside torch.func transforms and torch.compile, values cannot be read; the
            covariance of an undetermined pose is then NaN.

    Source: Hartley and Zisserman, 2nd ed., section 5.2 and appendix A6.3; Huber, Robust statistics,
    1981, section 7.6.
    """
    state = bundle.state()
    problem = bundle.problem()
    variance, dof = _noise(state, problem, bundle.weights > 0)
    system = linearise(state, replace(problem, loss="squared"))
    root, failed = torch.linalg.cholesky_ex(system.S)
    # A pose direction is undetermined if the elimination of the points removes almost all of its
    # information.
    information = root.diagonal(dim1=-2, dim2=-1) ** 2 / system.H.diagonal(dim1=-2, dim2=-1)
    undetermined = (failed > 0) | (information < _UNDETERMINED).any(-1)
    if not _traced() and bool(undetermined.any()):
        raise DegenerateGeometryError(
            "these matches do not determine the pose: its covariance is infinite in some "
            "direction. Causes are a plane seen almost head-on, points on the baseline, and a few "
            "matches that coincide; add matches elsewhere.",
            matches=problem.x1.shape[-2],
        )
    root = torch.where(undetermined[..., None, None], torch.nan, root)
    half = torch.linalg.solve_triangular(root, torch.eye(root.shape[-1]).to(root), upper=False)
    inverse = half.mT @ half
    kind = bundle.R.dtype
    return Uncertainty(
        (variance[..., None, None] * inverse[..., :5, :5]).to(kind),
        (variance[..., None, None, None] * _point_covariances(state, system, root)).to(kind),
        variance.sqrt().to(kind),
        dof,
    )


_UNDETERMINED = 1e-13  # share of the information: 450 times the rounding of float64


def sigma_degrees(pose_covariance: Tensor) -> Tensor:
    """Return the root-mean-square angular errors of rotation and direction of translation.

    Each is the square root of the trace of its block of the covariance, which is comparable with
    :func:`rotation_error` and :func:`translation_error`.

    Args:
        pose_covariance: ``(*B, 5, 5)`` covariance of a pose.

    Returns:
        ``(*B, 2)`` degrees.

    Raises:
        InputError: The shape or type is wrong, or a value is not finite.
    """
    check_matrices(shape=(5, 5), pose_covariance=pose_covariance)
    variances = pose_covariance.diagonal(dim1=-2, dim2=-1)
    return torch.rad2deg(
        torch.stack((variances[..., :3].sum(-1), variances[..., 3:].sum(-1)), -1).sqrt()
    )


def _noise(state: State, problem: Problem, used: Tensor) -> tuple[Tensor, Tensor]:
    """Return the variance of a coordinate of unit weight and its degrees of freedom."""
    r1, r2 = residuals(state, problem)
    s = r1[0] ** 2 + r1[1] ** 2 + r2[0] ** 2 + r2[1] ** 2
    matches = used.sum(-1)
    dof = matches - problem.size
    if not _traced() and bool((dof <= 0).any()):
        raise DegenerateGeometryError(
            f"{int(matches.min())} matches and {problem.size} camera unknowns leave no degrees of "
            "freedom from which to estimate the noise",
            matches=int(matches.min()),
            needed=problem.size + 1,
        )
    loss = problem.loss_terms(r1, r2)
    variance = (problem.weights * loss.slope**2 * s).sum(-1) / dof
    share = (used * (loss.slope + 2 * loss.curvature * s)).sum(-1) / matches
    return variance / share.clamp_min(0.1) ** 2, dof


def _point_covariances(state: State, system: Linearised, root: Tensor) -> Tensor:
    """Return the marginal covariance ``(*B, N, 3, 3)`` of the points for unit noise."""
    entries = (*state.y, *system.L)
    parts = zip(*(a.split(_CHUNK, -1) for a in entries), system.Z.split(_CHUNK, -1))
    return torch.cat([_point_covariance(part[:3], part[3:9], part[9], root) for part in parts], -3)


_CHUNK = 65_536  # keeps the intermediate tensors small


def _point_covariance(
    unknowns: tuple[Tensor, ...], L: tuple[Tensor, ...], Z: Tensor, root: Tensor
) -> Tensor:
    """Return the marginal covariance of some of the points.

    ``M (I + W W^T) M^T`` with ``M = dX/dy L^-T`` and ``W = Z S^(-1/2)``: the first term is the
    covariance at a fixed pose, the second is due to the uncertainty of the pose.
    """
    u, v, w = unknowns
    l00, l10, l11, l20, l21, l22 = L
    # L^-T is upper triangular: a b c / . d e / . . f.
    a, d, f = 1 / l00, 1 / l11, 1 / l22
    b, e = -l10 * a * d, -l21 * d * f
    c = (l10 * l21 * d - l20) * a * f
    x, y, z = u / w, v / w, 1 / w  # X = (u, v, 1) / rho
    zero = torch.zeros_like(a)
    M = torch.stack(
        (
            torch.stack((a * z, b * z, (c - x * f) * z), -1),
            torch.stack((zero, d * z, (e - y * f) * z), -1),
            torch.stack((zero, zero, -f * z * z), -1),
        ),
        -2,
    )
    by_point = Z[..., :-1, :, :].movedim(-1, -3)  # (*B, N, m, 3)
    W = torch.linalg.solve_triangular(root[..., None, :, :], by_point, upper=False).mT
    MW = M @ W
    return torch.where((w == 0)[..., None, None], torch.inf, M @ M.mT + MW @ MW.mT)
