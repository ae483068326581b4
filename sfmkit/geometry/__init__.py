"""Geometry of two views: pure torch functions on tensors ``(*B, N, 2)``.

The functions are batched and differentiable, and check their input. They call kornia where its
results are correct; ``docs/kornia.md`` states for each function which library computes it, and why.
:mod:`sfmkit.geometry.kernels` contains the inner loops, which do not check their input.
"""

from .block_covariance import (
    Sensitivity,
    camera_covariance,
    image_blocks,
    jackknife_covariance,
    linearise_pose,
    point_covariances,
    point_derivatives,
)
from .bundle import TwoViewBundle, bundle_adjust
from .camera import camera_from_pinhole, pinhole_from_camera
from .coordinates import (
    denormalize,
    from_homogeneous,
    hartley_normalization,
    inverse_intrinsics,
    normalize,
    to_homogeneous,
)
from .distortion import distort, distort_pixels, undistort, undistort_pixels
from .essential import (
    decompose_essential,
    essential_5point,
    essential_from_fundamental,
    essential_from_pose,
    project_to_essential,
)
from .focal import one_focal, shared_focal, two_focals
from .focal_refinement import FocalRefinement, refine_focal
from .fundamental import (
    epipolar_lines,
    epipoles,
    fundamental_7point,
    fundamental_8point,
    fundamental_from_essential,
    fundamental_from_pose,
    fundamental_from_projections,
    signed_sampson_distance,
    squared_sampson_distance,
    squared_symmetric_epipolar_distance,
)
from .homography import (
    decompose_homography,
    homography_4point,
    homography_dlt,
    homography_from_pose,
    squared_homography_sampson_distance,
    squared_symmetric_transfer_error,
    squared_transfer_error,
    transfer,
)
from .homography_refinement import refine_homography
from .lie import hat, so3_exp, so3_log, sphere_exp, tangent_basis
from .lines import clip_lines
from .losses import LossTerms, loss_terms, marginal_score, marginal_weight
from .pose import (
    check_pose,
    cheirality,
    choose_pose,
    pose_auc,
    pose_from_se3,
    relative_pose,
    rotation_error,
    se3_from_pose,
    translation_error,
)
from .refinement import EssentialRefinement, refine_essential
from .reprojection import project, reprojection_error, reprojection_residuals
from .sensitivity import Influence, influence, pose_sensitivity
from .similarity import Similarity, fit_similarity
from .triangulation import (
    corrected_matches,
    parallax,
    triangulate,
    triangulate_dlt,
    triangulate_midpoint,
    triangulate_optimal,
)
from .uncertainty import Uncertainty, covariance, sigma_degrees

__all__ = [
    "EssentialRefinement",
    "FocalRefinement",
    "Influence",
    "LossTerms",
    "Sensitivity",
    "Similarity",
    "TwoViewBundle",
    "Uncertainty",
    "bundle_adjust",
    "camera_covariance",
    "camera_from_pinhole",
    "check_pose",
    "cheirality",
    "choose_pose",
    "clip_lines",
    "corrected_matches",
    "covariance",
    "decompose_essential",
    "decompose_homography",
    "denormalize",
    "distort",
    "distort_pixels",
    "epipolar_lines",
    "epipoles",
    "essential_5point",
    "essential_from_fundamental",
    "essential_from_pose",
    "fit_similarity",
    "from_homogeneous",
    "fundamental_7point",
    "fundamental_8point",
    "fundamental_from_essential",
    "fundamental_from_pose",
    "fundamental_from_projections",
    "hartley_normalization",
    "hat",
    "homography_4point",
    "homography_dlt",
    "homography_from_pose",
    "image_blocks",
    "influence",
    "inverse_intrinsics",
    "jackknife_covariance",
    "linearise_pose",
    "loss_terms",
    "marginal_score",
    "marginal_weight",
    "normalize",
    "one_focal",
    "parallax",
    "pinhole_from_camera",
    "point_covariances",
    "point_derivatives",
    "pose_auc",
    "pose_from_se3",
    "pose_sensitivity",
    "project",
    "project_to_essential",
    "refine_essential",
    "refine_focal",
    "refine_homography",
    "relative_pose",
    "reprojection_error",
    "reprojection_residuals",
    "rotation_error",
    "se3_from_pose",
    "shared_focal",
    "sigma_degrees",
    "signed_sampson_distance",
    "so3_exp",
    "so3_log",
    "sphere_exp",
    "squared_homography_sampson_distance",
    "squared_sampson_distance",
    "squared_symmetric_epipolar_distance",
    "squared_symmetric_transfer_error",
    "squared_transfer_error",
    "tangent_basis",
    "to_homogeneous",
    "transfer",
    "translation_error",
    "triangulate",
    "triangulate_dlt",
    "triangulate_midpoint",
    "triangulate_optimal",
    "two_focals",
    "undistort",
    "undistort_pixels",
]
