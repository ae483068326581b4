"""The fundamental matrix against known cameras, OpenCV and closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from made_up_scene import make_scene, same_up_to_sign
from torch.autograd import gradcheck

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry import kernels
from sfmkit.geometry.coordinates import to_homogeneous
from sfmkit.geometry.fundamental import (
    epipolar_lines,
    epipoles,
    fundamental_7point,
    fundamental_8point,
    fundamental_from_pose,
    signed_sampson_distance,
    squared_sampson_distance,
    squared_symmetric_epipolar_distance,
)

EXACT = make_scene(80)
NOISY = make_scene(80, noise=0.5)
F = kernels.unit_norm(fundamental_from_pose(EXACT.R, EXACT.t, EXACT.K1, EXACT.K2))


def test_eight_points_recover_an_exact_fundamental_matrix():
    assert float(same_up_to_sign(fundamental_8point(EXACT.x1, EXACT.x2), F)) < 1e-12
    assert float(same_up_to_sign(fundamental_8point(EXACT.x1[:8], EXACT.x2[:8]), F)) < 1e-9


def test_eight_points_agree_with_opencv_on_noise():
    ours = fundamental_8point(NOISY.x1, NOISY.x2)
    theirs, _ = cv2.findFundamentalMat(NOISY.x1.numpy(), NOISY.x2.numpy(), cv2.FM_8POINT)
    apart = (
        signed_sampson_distance(ours, NOISY.x1, NOISY.x2).abs()
        - signed_sampson_distance(torch.from_numpy(theirs), NOISY.x1, NOISY.x2).abs()
    )
    assert (
        float(apart.abs().max()) < 0.02
    )  # OpenCV normalises by the mean distance, sfmkit by the root mean square
    assert abs(float(torch.linalg.det(ours))) < 1e-18


def test_seven_points_give_the_true_matrix_and_the_solutions_of_opencv():
    g = torch.Generator().manual_seed(0)
    index = torch.stack([torch.randperm(80, generator=g)[:7] for _ in range(50)])
    solutions, valid = fundamental_7point(EXACT.x1[index], EXACT.x2[index])
    assert float(torch.where(valid, same_up_to_sign(solutions, F), torch.inf).amin(-1).max()) < 1e-8
    assert torch.equal(solutions[~valid], torch.zeros_like(solutions[~valid]))
    for i in range(20):
        theirs, _ = cv2.findFundamentalMat(
            EXACT.x1[index[i]].numpy(), EXACT.x2[index[i]].numpy(), cv2.FM_7POINT
        )
        theirs = kernels.unit_norm(torch.from_numpy(theirs.reshape(-1, 3, 3)))
        assert len(theirs) == int(valid[i].sum())
        for M in theirs:
            assert (
                float(same_up_to_sign(solutions[i][valid[i]], M).min()) < 1e-4
            )  # OpenCV computes in pixels without normalisation


def test_lines_contain_the_matches_and_intersect_in_the_epipoles():
    lines = epipolar_lines(F, EXACT.x1)
    assert float((lines * to_homogeneous(EXACT.x2)).sum(-1).abs().max()) < 1e-9
    assert torch.allclose(lines[:, :2].norm(dim=-1), torch.ones(80).double())
    e1, e2 = epipoles(F)
    assert float((lines @ e2).abs().max()) < 1e-9
    theirs = cv2.computeCorrespondEpilines(EXACT.x1.numpy().reshape(-1, 1, 2), 1, F.numpy())[:, 0]
    assert np.allclose(
        np.minimum(np.abs(theirs - lines.numpy()), np.abs(theirs + lines.numpy())), 0, atol=1e-9
    )
    centre = EXACT.K1 @ (-EXACT.R.T @ EXACT.t)  # centre of the other camera in this frame
    assert float(same_up_to_sign(e1[:, None], (centre / centre.norm())[:, None])) < 1e-9


def test_distances_for_a_sideways_motion_are_known():
    """Test distances for epipolar lines that are rows.

    A match that is wrong by v pixels has the Sampson distance v / √2 and the squared symmetric
    distance 2 v².
    """
    rows = torch.tensor([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)
    x1 = torch.tensor([[10.0, 20.0], [5.0, 5.0]], dtype=torch.float64)
    x2 = x1 + torch.tensor([7.0, 3.0], dtype=torch.float64)
    expected = torch.full((2,), 3 / 2**0.5, dtype=torch.float64)
    assert torch.allclose(signed_sampson_distance(rows, x1, x2).abs(), expected)
    assert torch.allclose(squared_sampson_distance(9 * rows, x1, x2), expected**2)
    assert torch.allclose(
        squared_symmetric_epipolar_distance(rows, x1, x2), torch.full((2,), 18.0).double()
    )


def test_sampson_distance_agrees_with_opencv():
    ours = squared_sampson_distance(F, NOISY.x1, NOISY.x2)
    for i in range(10):
        p1, p2 = (to_homogeneous(x[i, None]).numpy().T for x in (NOISY.x1, NOISY.x2))
        assert cv2.sampsonDistance(p1, p2, F.numpy()) == pytest.approx(float(ours[i]), rel=1e-9)


def test_hypotheses_broadcast_over_shared_points():
    many = torch.stack((F, F.mT, torch.eye(3).double()))
    together = signed_sampson_distance(many, NOISY.x1.expand(3, -1, -1), NOISY.x2.expand(3, -1, -1))
    assert torch.equal(
        together, torch.stack([signed_sampson_distance(M, NOISY.x1, NOISY.x2) for M in many])
    )


def test_batch_equals_singles_and_float32_is_close():
    a, b = torch.stack((EXACT.x1, NOISY.x1)), torch.stack((EXACT.x2, NOISY.x2))
    both = fundamental_8point(a, b)
    for i in range(2):
        assert float(same_up_to_sign(both[i], fundamental_8point(a[i], b[i]))) < 1e-14
    single = fundamental_8point(a.float(), b.float())
    assert (
        float(
            (
                signed_sampson_distance(single.double(), a, b).abs()
                - signed_sampson_distance(both, a, b).abs()
            )
            .abs()
            .max()
        )
        < 1e-3
    )


@pytest.mark.parametrize("scene", ["plane", "collinear", "repeated"])
def test_matches_that_do_not_determine_f_are_rejected(scene):
    s = make_scene(30, planar=True)
    x1, x2 = s.x1, s.x2
    if scene == "collinear":
        x1 = torch.linspace(0, 99, 30, dtype=torch.float64)[:, None] * torch.tensor(
            [1.0, 2.0], dtype=torch.float64
        )
        x2 = x1 * 1.5 + 3
    if scene == "repeated":
        x1, x2 = x1[:1].repeat(30, 1), x2[:1].repeat(30, 1)
    with pytest.raises(DegenerateGeometryError, match="do not determine F"):
        fundamental_8point(x1, x2)


def test_bad_input_is_named():
    with pytest.raises(DegenerateGeometryError, match="at least 8"):
        fundamental_8point(EXACT.x1[:7], EXACT.x2[:7])
    with pytest.raises(InputError, match="exactly 7"):
        fundamental_7point(EXACT.x1[:8], EXACT.x2[:8])
    with pytest.raises(InputError, match="must be the same"):
        fundamental_8point(EXACT.x1, EXACT.x2[:40])
    with pytest.raises(InputError, match="NaN"):
        fundamental_8point(EXACT.x1 * torch.nan, EXACT.x2)
    with pytest.raises(InputError, match="same dtype"):
        fundamental_8point(EXACT.x1, EXACT.x2.float())


@pytest.mark.grad
def test_derivatives():
    x1, x2 = (x[:9].clone().requires_grad_() for x in (NOISY.x1, NOISY.x2))
    w = torch.linspace(0.5, 1, 9, dtype=torch.float64).requires_grad_()
    assert gradcheck(
        lambda a, b, w: (lambda M: M * M[2, 2].sign())(fundamental_8point(a, b, w)), (x1, x2, w)
    )
    a, b = ((x[:7] / 100).detach().requires_grad_() for x in (x1, x2))
    assert gradcheck(lambda a, b: fundamental_7point(a, b)[0], (a, b))
    M = torch.rand(
        3, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64
    ).requires_grad_()
    for function in (signed_sampson_distance, squared_symmetric_epipolar_distance):
        assert gradcheck(function, (M, a, b))
    assert gradcheck(epipolar_lines, (M, a))
    assert gradcheck(lambda M: tuple(e * e[0].sign() for e in epipoles(M)), (M,))


@pytest.mark.grad
def test_derivatives_are_finite_at_an_exact_solution():
    x1, x2 = (x[:20].clone().requires_grad_() for x in (EXACT.x1, EXACT.x2))
    signed_sampson_distance(fundamental_8point(x1, x2), x1, x2).square().sum().backward()
    assert torch.isfinite(x1.grad).all()
    assert torch.isfinite(x2.grad).all()
    jacobian = torch.func.vmap(torch.func.jacrev(lambda a, b: fundamental_7point(a, b)[0]))(
        EXACT.x1[:14].reshape(2, 7, 2), EXACT.x2[:14].reshape(2, 7, 2)
    )
    assert torch.isfinite(jacobian).all()
