"""Two-view bundle adjustment: joint refinement of pose and points."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import DegenerateGeometryError, InputError
from ._bundle_implicit import BundleObjective, from_unknowns, to_unknowns
from ._implicit import attach_derivatives, is_differentiated
from ._levenberg_marquardt import Minimised, Schedule, Trial, levenberg_marquardt
from ._two_view_problem import FREE_FOCALS, Focal, Problem, State, linearise, settle_points
from .checks import _traced, check_intrinsics, check_points
from .kernels import normalize
from .loss_kernels import Loss
from .pose import check_pose
from .triangulation import triangulate_optimal

_TOLERANCE = 1e-12  # share of the cost: the predicted decrease at convergence
_EXACT = 1e-20  # square pixels per match: rounding of the residuals
_DAMPING = 1e-4  # initial value
_POLISH = 2  # steps; each leaves about a tenth of the error
# share of the damping that applies to the points: they need little, and their damping also slows
# down the convergence of the camera
_POINT_DAMPING = 1e-5


@dataclass(frozen=True, eq=False)
class TwoViewBundle:
    """Two cameras and their points at a minimum of the reprojection error.

    Attributes:
        R: ``(*B, 3, 3)`` rotation.
        t: ``(*B, 3)`` translation of unit length, ``X2 = R X1 + t``.
        inverse_depth: ``(*B, N, 3)`` points as ``(u, v, rho)``: normalised coordinates in image 1
            and inverse depth. rho is zero at infinity, and negative where the rays meet behind
            camera 1.
        K1, K2: ``(*B, 3, 3)`` intrinsics, with the estimated focal lengths if these are free.
        cost: ``(*B, iterations + 1)`` half the weighted loss, square pixels, at the start and after
            each step.
        iterations: ``(*B,)`` int64 number of linearisations until convergence.
        converged: ``(*B,)`` bool, whether the minimisation converged.
        x1, x2, weights, loss, loss_scale, focal: The problem that was solved.
    """

    R: Tensor
    t: Tensor
    inverse_depth: Tensor
    K1: Tensor
    K2: Tensor
    cost: Tensor
    iterations: Tensor
    converged: Tensor
    x1: Tensor
    x2: Tensor
    weights: Tensor
    loss: Loss
    loss_scale: float
    focal: Focal

    @property
    def X(self) -> Tensor:
        """Return the points ``(*B, N, 3)`` in the frame of camera 1, in baselines.

        Points at infinity have infinite coordinates.
        """
        rho = self.inverse_depth[..., 2:]
        infinite = rho == 0
        ray = torch.cat((self.inverse_depth[..., :2], torch.ones_like(rho)), -1)
        return torch.where(infinite, torch.inf, ray / torch.where(infinite, 1.0, rho))

    def problem(self) -> Problem:
        """Return the least-squares problem for the estimated cameras, float64."""
        x1, x2, weights, K1, K2 = (
            a.double() for a in (self.x1, self.x2, self.weights, self.K1, self.K2)
        )
        return Problem(x1, x2, _regular(weights), K1, K2, self.loss, self.loss_scale, self.focal)

    def state(self) -> State:
        """Return the unknowns at the minimum, float64, with focal scales relative to K1, K2."""
        u, v, w = self.inverse_depth.double().unbind(-1)
        log_focal = torch.zeros((*self.t.shape[:-1], 2), dtype=torch.float64, device=self.t.device)
        return State(self.R.double(), self.t.double(), log_focal, (u, v, w))


def bundle_adjust(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    R: Tensor,
    t: Tensor,
    weights: Tensor | None = None,
    *,
    loss: Loss = "squared",
    loss_scale: float = 1.0,
    focal: Focal = "fixed",
    max_iterations: int = 50,
) -> TwoViewBundle:
    """Refine the pose, all points and, optionally, the focal lengths from an initial pose.

    The Levenberg-Marquardt algorithm runs on the reduced camera system with analytic Jacobians.
    Points are parametrised by direction and inverse depth. Time and memory are linear in N.

    The minimum is differentiable with respect to x1, x2, weights, K1 and K2, in reverse and forward
    mode and more than once (implicit function theorem, exact Hessian). The time of a derivative
    does not depend on the number of iterations. The derivative with respect to the initial pose is
    zero.

    Args:
        x1, x2: ``(*B, N, 2)`` undistorted pixels; N is at least 5 plus the number of free focal
            lengths.
        K1, K2: ``(*B, 3, 3)`` intrinsics.
        R, t: ``(*B, 3, 3)``, ``(*B, 3)`` initial pose; the length of t does not matter.
        weights: ``(*B, N)`` relative precision (inverse variance) of each match, not negative; ones
            by default.
        loss, loss_scale: Loss of the residual of a match, a 4-vector over both images, and its
            scale in pixels; see :func:`sfmkit.geometry.losses.loss_terms`.
        focal: ``fixed``, ``shared`` (K1 and K2 scaled by one factor) or ``separate``. A free focal
            length is well determined only where the optical axes do not meet (Kanatani and
            Matsunaga 2000); check the covariance.
        max_iterations: Maximum number of iterations; 0 only triangulates at the given pose.

    Raises:
        InputError: Shapes, dtypes or devices do not fit, a value is NaN, an option is unknown, or t
            is zero.
        DegenerateGeometryError: There are too few matches.

    Source: Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment - a modern synthesis,
    2000.
    """
    if focal not in FREE_FOCALS:
        raise InputError(f"focal must be 'fixed', 'shared' or 'separate', not {focal!r}")
    if not loss_scale > 0:
        raise InputError(f"loss_scale must be positive (pixels), not {loss_scale}")
    check_points(minimum=5 + FREE_FOCALS[focal], weights=weights, x1=x1, x2=x2)
    if (
        weights is not None
        and not _traced()
        and int((weights > 0).sum(-1).min()) < 5 + FREE_FOCALS[focal]
    ):
        raise DegenerateGeometryError(
            "too few matches have a positive weight",
            matches=int((weights > 0).sum(-1).min()),
            needed=5 + FREE_FOCALS[focal],
        )
    check_intrinsics(x1, K1=K1, K2=K2)
    check_pose(R, t, like=x1)
    try:
        batch = torch.broadcast_shapes(
            x1.shape[:-2], K1.shape[:-2], K2.shape[:-2], R.shape[:-2], t.shape[:-1]
        )
    except RuntimeError:
        raise InputError("the batch shapes of x1, K1, K2, R and t do not fit together") from None
    ones = x1.new_ones(x1.shape[:-1]) if weights is None else weights
    problem = Problem(
        x1.double(),
        x2.double(),
        _regular(ones.double()),
        K1.double(),
        K2.double(),
        loss,
        loss_scale,
        focal,
    )
    fixed = problem.detached()

    state = _start(
        fixed, R.detach().double().expand(*batch, 3, 3), t.detach().double().expand(*batch, 3)
    )
    differentiated = max_iterations > 0 and is_differentiated(problem.data)
    found = _minimise(state, fixed, max_iterations, _POLISH if differentiated else 0)
    state = found.state
    if differentiated:
        objective = BundleObjective(fixed)
        state = from_unknowns(attach_derivatives(objective, to_unknowns(state), problem.data))
    f1, f2 = state.log_focal.exp().unbind(-1)
    kind = x1.dtype
    return TwoViewBundle(
        state.R.to(kind),
        state.t.to(kind),
        torch.stack(state.y, -1).to(kind),
        _with_focal(problem.K1, f1).to(kind),
        _with_focal(problem.K2, f2).to(kind),
        found.history.to(kind),
        found.iterations,
        found.converged,
        x1,
        x2,
        ones,
        loss,
        loss_scale,
        focal,
    )


def _regular(weights: Tensor) -> Tensor:
    """Replace zero weights by tiny ones, so that every match determines its point."""
    return weights + 1e-12 * weights.detach().amax(-1, keepdim=True)


def _start(problem: Problem, R: Tensor, t: Tensor) -> State:
    t = t / t.norm(dim=-1, keepdim=True)
    xn1, xn2 = normalize(problem.x1, problem.K1), normalize(problem.x2, problem.K2)
    X = triangulate_optimal(xn1, xn2, R, t, homogeneous=True)
    x, y, z, w = X.unbind(-1)
    return State(R, t, torch.zeros_like(t[..., :2]), (x / z, y / z, w / z))


def _minimise(state: State, problem: Problem, max_iterations: int, polish: int) -> Minimised[State]:
    def propose(state: State, damping: Tensor, near: Tensor) -> Trial[State]:
        system = linearise(state, problem, _POINT_DAMPING * damping, near)
        diagonal = torch.diag_embed(damping[..., None] * system.S.diagonal(dim1=-2, dim2=-1))
        camera = -torch.linalg.solve_ex(system.S + diagonal, system.g[..., None])[0][..., 0]
        trial = problem.move(state, camera, system.solve_points(camera))
        # The cost is evaluated after a second step of the points alone, so that it shows the effect
        # of the camera step. In a curved valley (a free focal length), this reduces the number of
        # iterations to a tenth.
        trial = settle_points(trial, problem, _POINT_DAMPING * damping)
        # The predicted gain of a full step: first of the points, then of the camera.
        own = system.Z[..., -1, :, :]
        gain = (own * own).sum((-1, -2)) - (camera * system.g).sum(-1)
        return Trial(trial, problem.cost(trial), gain)

    schedule = Schedule(
        max_iterations, _TOLERANCE, _EXACT * problem.x1.shape[-2], _DAMPING, polish=polish
    )
    return levenberg_marquardt(state, problem.cost(state), propose, schedule)


def _with_focal(K: Tensor, f: Tensor) -> Tensor:
    """Return K with its focal lengths and skew multiplied by f."""
    one = torch.ones_like(f)
    first = torch.stack((f, f, one), -1)
    return K * torch.stack((first, first, torch.ones_like(first)), -2)
