"""The last refinement: pose and points together, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from .._utils.threads import one_thread
from ..errors import DegenerateGeometryError
from ..geometry.bundle import bundle_adjust
from ..geometry.essential import essential_from_pose
from ..geometry.fundamental import fundamental_from_essential
from ..geometry.loss_kernels import Loss
from ..geometry.uncertainty import covariance, sigma_degrees
from ..types import Correspondences, TwoView
from .pose_uncertainty import pose_uncertainty
from .two_view import undistorted_pixels

LOSS: Loss = "cauchy"
LOSS_SCALE_PX = (
    0.5  # as in the refinement of E before: the residuals of good matches are about 0.3 px
)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A two-view geometry after bundle adjustment.

    Attributes:
        view: with the refined pose, its covariance and standard deviations.
        rows: (M,) int64 correspondences that took part, the inliers.
        covariance: (M, 3, 3) of their points, squared baselines, the uncertainty of the pose
            included.
        sigma_px: standard deviation of one pixel coordinate, estimated from the residuals.
        iterations: linearisations until convergence.
    """

    view: TwoView
    rows: Tensor
    covariance: Tensor
    sigma_px: float
    iterations: int


@one_thread()
def adjust(corr: Correspondences, view: TwoView) -> Adjustment | None:
    """Refine a geometry and its points by bundle adjustment over its inliers.

    The inliers stay as they are.

    Returns:
        None where there is no translation, where the matches leave the pose undetermined in some
        direction, or where they are too few to estimate the noise.
    """
    if view.R is None or view.t is None:
        return None
    rows = view.inliers.nonzero().squeeze(1)
    x1, x2 = undistorted_pixels(corr, view.camera1, view.camera2)
    (K1, _), (K2, _) = view.camera1.tensors(), view.camera2.tensors()
    try:
        bundle = bundle_adjust(
            x1[rows], x2[rows], K1, K2, view.R, view.t, loss=LOSS, loss_scale=LOSS_SCALE_PX
        )
        independent = covariance(bundle)
    except DegenerateGeometryError:
        return None
    uncertainty = pose_uncertainty(
        bundle.R,
        bundle.t,
        x1[rows],
        x2[rows],
        (view.camera1, view.camera2),
        independent,
        loss=LOSS,
        loss_scale=LOSS_SCALE_PX,
    )
    E = essential_from_pose(bundle.R, bundle.t)
    rotation_deg, translation_deg = sigma_degrees(uncertainty.pose).tolist()
    return Adjustment(
        view=replace(
            view,
            R=bundle.R,
            t=torch.nn.functional.normalize(bundle.t, dim=0),
            E=E,
            F=fundamental_from_essential(E, K1, K2),
            pose_covariance=uncertainty.pose,
            sigma_deg=(rotation_deg, translation_deg),
            sigma_parts_deg=uncertainty.parts_deg,
            evidence={**view.evidence, "sigma_px": float(independent.sigma_px)},
        ),
        rows=rows,
        covariance=uncertainty.points,
        sigma_px=float(independent.sigma_px),
        iterations=int(bundle.iterations),
    )
