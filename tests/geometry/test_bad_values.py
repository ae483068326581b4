"""NaN, singular and zero input: an SfmError or the documented result."""

from __future__ import annotations

import pytest
import torch

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry import (
    choose_pose,
    clip_lines,
    corrected_matches,
    decompose_essential,
    decompose_homography,
    denormalize,
    epipoles,
    essential_5point,
    fit_similarity,
    hat,
    homography_4point,
    homography_from_pose,
    loss_kernels,
    loss_terms,
    marginal_score,
    marginal_weight,
    normalize,
    pose_auc,
    project,
    project_to_essential,
    refine_homography,
    relative_pose,
    reprojection_error,
    reprojection_residuals,
    sigma_degrees,
    so3_exp,
    sphere_exp,
    squared_homography_sampson_distance,
    squared_symmetric_transfer_error,
    to_homogeneous,
    triangulate_dlt,
)

D = torch.float64
EYE, ZERO = torch.eye(3, dtype=D), torch.zeros(3, 3, dtype=D)
NAN = torch.full((2, 2), torch.nan, dtype=D)
X = torch.rand(4, 2, generator=torch.Generator().manual_seed(0), dtype=D)


@pytest.mark.parametrize(
    "call",
    [
        lambda: normalize(NAN, EYE),
        lambda: denormalize(NAN, EYE),
        lambda: homography_from_pose(EYE * torch.nan, EYE[0], EYE[2], 1.0, EYE, EYE),
        lambda: homography_from_pose(EYE, EYE[0] * torch.nan, EYE[2], 1.0, EYE, EYE),
        lambda: homography_from_pose(EYE, EYE[0], EYE[2], torch.nan, EYE, EYE),
        lambda: relative_pose(EYE * torch.nan, EYE[0], EYE, EYE[0]),
        lambda: loss_terms("cauchy", X, 0.0),
        lambda: pose_auc(torch.zeros(0, dtype=D), [1.0]),
        lambda: pose_auc(X[0], [0.0]),
        lambda: homography_4point(torch.rand(5, 2), torch.rand(5, 2)),
    ],
)
def test_bad_input_is_rejected(call):
    with pytest.raises(InputError):
        call()


@pytest.mark.parametrize(
    "call",
    [
        lambda: squared_symmetric_transfer_error(ZERO, X, X),
        lambda: squared_symmetric_transfer_error(torch.ones(3, 3, dtype=D), X, X),
        lambda: decompose_homography(ZERO, EYE, EYE),
        lambda: homography_from_pose(EYE, EYE[0], EYE[2], 0.0, EYE, EYE),
        lambda: epipoles(ZERO),
        lambda: project_to_essential(ZERO),
        lambda: decompose_essential(ZERO),
    ],
)
def test_degenerate_geometry_is_reported(call):
    with pytest.raises(DegenerateGeometryError):
        call()


def test_unchecked_functions_return_nan_for_nan():
    assert so3_exp(torch.full((3,), torch.nan)).isnan().any()
    assert loss_kernels.loss_terms("cauchy", NAN, 1.0).value.isnan().all()


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_losses_reject_values_that_are_not_finite(bad):
    square = torch.tensor([1.0, bad], dtype=D)
    calls = (
        lambda: loss_terms("cauchy", square, 1.0),
        lambda: marginal_weight(square, 1.0),
        lambda: marginal_score(square, 1.0),
    )
    for call in calls:
        with pytest.raises(InputError, match="square holds NaN or infinite"):
            call()


def test_failed_pairs_count_as_failures_in_the_area():
    errors = torch.tensor([0.0, torch.nan, torch.inf, 0.0], dtype=D)
    assert float(pose_auc(errors, [5.0])) == 0.5


def test_distance_to_a_zero_homography_is_infinite_with_finite_gradient():
    H = ZERO.clone().requires_grad_()
    square = squared_homography_sampson_distance(H, X, X)
    assert square.isinf().all()
    assert torch.autograd.grad(square.clamp(max=9).sum(), H)[0].isfinite().all()


def test_repeated_matches_give_no_solution_that_is_not_finite():
    g = torch.Generator().manual_seed(0)
    x1, x2 = (
        torch.rand(156, 5, 2, generator=g, dtype=D),
        torch.rand(156, 5, 2, generator=g, dtype=D),
    )
    for k in range(156):  # one to four copies of the first match
        copies = k % 4 + 1
        x1[k, 5 - copies :], x2[k, 5 - copies :] = x1[k, 0], x2[k, 0]
    E, valid = essential_5point(x1 - 0.5, x2 - 0.5)
    assert E[valid].isfinite().all()


POINTS = torch.cat((X, torch.ones(4, 1, dtype=D)), -1)


@pytest.mark.parametrize(
    "call",
    [
        lambda: hat(torch.ones(2, dtype=D)),
        lambda: so3_exp(torch.ones(3, dtype=torch.int64)),
        lambda: sphere_exp(torch.ones(2, 3, dtype=D), torch.ones(3, 3, dtype=D)),
        lambda: to_homogeneous(torch.ones(2, dtype=D)),
        lambda: sigma_degrees(torch.eye(4, dtype=D)),
        lambda: loss_terms("huber", torch.ones(2, dtype=torch.complex128), 1.0),
        lambda: marginal_score(torch.ones(2, dtype=D), 1e-300),
        lambda: marginal_score(torch.ones(2), 1e30),
        lambda: loss_terms("cauchy", torch.ones(2), 1e-30),
        lambda: pose_auc(torch.ones(2, dtype=D), torch.ones(2, 2)),
        lambda: pose_auc(torch.ones(2, dtype=torch.bool), [5.0]),
        lambda: clip_lines(torch.ones(4, 2, dtype=D), (640, 480)),
        lambda: corrected_matches(X, X, EYE[:, :2], EYE[0]),
        lambda: choose_pose(EYE, EYE[0], X, X),
        lambda: choose_pose(EYE.expand(0, 3, 3), EYE[:0], X, X),
        lambda: homography_from_pose(EYE, EYE[:2], EYE[2], torch.ones(5), EYE, EYE),
        lambda: relative_pose(EYE.expand(2, 3, 3), EYE[0], EYE.expand(5, 3, 3), EYE[0]),
        lambda: normalize(X.expand(5, 4, 2), EYE.expand(2, 3, 3)),
        lambda: reprojection_error(POINTS[:3], X, X, EYE, EYE, EYE, EYE[0]),
    ],
)
def test_wrong_shapes_types_and_scales_are_rejected(call):
    with pytest.raises(InputError, match=r".+"):
        call()


def test_numbers_whose_squares_overflow_are_rejected():
    many = torch.rand(12, 3, generator=torch.Generator().manual_seed(0), dtype=D)
    with pytest.raises(DegenerateGeometryError, match="range of floats"):
        refine_homography(EYE, many[:, :2] * 1e160, many[:, :2])
    with pytest.raises(DegenerateGeometryError, match="range of floats"):
        fit_similarity(many * 1e300, many * 1e300)


def test_unbatched_points_broadcast_against_batched_poses():
    R, t = EYE.expand(2, 3, 3), torch.tensor([[1.0, 0, 0], [0, 1.0, 0]], dtype=D)
    x2 = [(POINTS + s)[..., :2] for s in t]
    assert triangulate_dlt(X, x2[0], EYE, t).shape == (2, 4, 3)
    torch.testing.assert_close(triangulate_dlt(X, x2[0], EYE, t[0]), POINTS)
    r = reprojection_residuals(POINTS, X, x2[0], EYE, EYE, R, t)
    torch.testing.assert_close(r[0], torch.zeros(4, 4, dtype=D))
    assert r.shape == (2, 4, 4)
    (first, _), _ = corrected_matches(X, x2[0], EYE, t)  # one rotation, two translations
    assert first.shape == (2, 4)


def test_batches_that_do_not_fit_are_rejected():
    X, K = torch.ones(2, 5, 3, dtype=D), EYE.expand(3, 3, 3)
    with pytest.raises(InputError, match="batch dimensions"):
        project(X, K)
    with pytest.raises(InputError, match="batch dimensions"):
        project(X, EYE, EYE.expand(4, 3, 3), torch.ones(3, dtype=D))


@pytest.mark.parametrize("scale", [1e-160, 1e160])
def test_the_scale_of_a_homography_does_not_matter(scale):
    H = torch.tensor([[1.1, 0.02, 0.3], [0.01, 0.95, -0.2], [0.05, 0.02, 1.0]], dtype=D)
    for a, b in zip(decompose_homography(scale * H, EYE, EYE), decompose_homography(H, EYE, EYE)):
        torch.testing.assert_close(a, b)
