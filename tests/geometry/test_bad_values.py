"""NaN, singular and zero input: an SfmError, or the documented result."""

from __future__ import annotations

import pytest
import torch

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry import (
    decompose_essential,
    decompose_homography,
    denormalize,
    epipoles,
    essential_5point,
    homography_4point,
    homography_from_pose,
    loss_terms,
    normalize,
    pose_auc,
    project_to_essential,
    relative_pose,
    so3_exp,
    squared_homography_sampson_distance,
    squared_symmetric_transfer_error,
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


def test_unchecked_functions_keep_nan_visible():
    assert so3_exp(torch.full((3,), torch.nan)).isnan().any()
    assert loss_terms("cauchy", NAN, 1.0).value.isnan().all()


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
