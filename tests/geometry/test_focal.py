"""Focal lengths in closed form and by refinement: known scenes, SciPy, PoseLib, differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up_scene import make_scene
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation
from torch.autograd import gradcheck

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.block_covariance import linearise_pose
from sfmkit.geometry.distortion import distort
from sfmkit.geometry.focal import one_focal, shared_focal, two_focals
from sfmkit.geometry.focal_refinement import refine_focal
from sfmkit.geometry.fundamental import (
    fundamental_8point,
    fundamental_from_pose,
    signed_sampson_distance,
)
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.losses import loss_terms
from sfmkit.geometry.pose import rotation_error

S, NOISY = make_scene(60), make_scene(60, noise=0.5)
START = so3_exp(torch.tensor([0.02, -0.01, 0.015], dtype=torch.float64)) @ S.R, S.t + 0.05


def factor(s: float) -> torch.Tensor:
    return torch.diag(torch.tensor([s, s, 1.0], dtype=torch.float64))


def matrix(s1: float, s2: float) -> torch.Tensor:
    """M of intrinsics whose focal lengths are too small by these factors."""
    F = fundamental_from_pose(S.R, S.t, S.K1, S.K2)
    return factor(1 / s2) @ S.K2.mT @ F @ S.K1 @ factor(1 / s1)


@pytest.mark.parametrize("s1, s2", [(1.3, 1.3), (0.7, 0.7), (1.2, 0.8), (1.0, 1.6)])
def test_closed_forms_recover_the_factors_of_an_exact_matrix(s1, s2):
    M = 7.0 * matrix(s1, s2)
    first, second, valid = two_focals(M)
    assert bool(valid)
    assert [float(first), float(second)] == pytest.approx([s1, s2], rel=1e-10)
    unknown, valid = one_focal(factor(s2) @ M)
    assert bool(valid)
    only_first, _ = one_focal((factor(s2) @ M).mT)
    assert float(unknown) == pytest.approx(1.0) if s1 == 1 else float(unknown) > 0
    assert float(only_first) == pytest.approx(s1, rel=1e-10)
    if s1 == s2:
        shared, valid = shared_focal(M)
        assert bool(valid[0])
        assert float(shared[0]) == pytest.approx(s1, rel=1e-10)


def noisy_matrix() -> torch.Tensor:
    K = torch.tensor([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]], dtype=torch.float64)
    return K.mT @ fundamental_8point(NOISY.x1, NOISY.x2) @ K


def test_candidates_are_where_the_singular_values_are_most_equal():
    M = noisy_matrix()

    def inequality(log_s: float, shared: bool) -> float:
        D = factor(np.exp(log_s))
        values = torch.linalg.svdvals(D @ M @ D if shared else D @ M)
        return float(values[0] / values[1])

    for shared, (s, valid) in ((True, shared_focal(M)), (False, one_focal(M))):
        best = minimize_scalar(
            inequality,
            bounds=(-1.5, 1.5),
            args=(shared,),
            method="bounded",
            options={"xatol": 1e-9},
        )
        assert bool(valid.flatten()[0])
        assert float(s.flatten()[0].log()) == pytest.approx(best.x, abs=1e-5)


@pytest.mark.peers
def test_two_focal_lengths_are_poselibs():
    poselib = pytest.importorskip("poselib")
    F = fundamental_8point(NOISY.x1, NOISY.x2)
    centre = np.array([320.0, 240.0])
    first, second, *_ = poselib.focals_from_fundamental(F.numpy(), centre, centre)
    lengths = [camera.params[0] for camera in (first, second)]
    s1, s2, _ = two_focals(noisy_matrix())
    assert [600 * float(s1), 600 * float(s2)] == pytest.approx(lengths, rel=1e-8)


def test_batches_agree_with_single_calls_and_what_has_no_solution_says_so():
    batch = torch.stack([matrix(1.3, 1.3), noisy_matrix(), torch.eye(3, dtype=torch.float64)])
    for function in (shared_focal, one_focal, two_focals):
        *lengths, valid = function(batch)
        for k in range(2):
            *single, _ = function(batch[k])
            for one, many in zip(single, lengths):
                torch.testing.assert_close(one, many[k])
        assert all(bool((a > 0).all() and a.isfinite().all()) for a in lengths)
        assert valid.dtype == torch.bool
    sideways = make_scene(20)
    M = fundamental_from_pose(torch.eye(3).double(), sideways.t, *[torch.eye(3).double()] * 2)
    assert not bool(two_focals(M)[2])
    with pytest.raises(DegenerateGeometryError):
        shared_focal(torch.zeros(3, 3))


@pytest.mark.grad
def test_derivatives_of_the_closed_forms():
    M = noisy_matrix().requires_grad_()
    assert gradcheck(lambda M: shared_focal(M)[0][:1], M, eps=1e-4, rtol=1e-4)
    for function in (one_focal, two_focals):
        assert gradcheck(lambda M, f=function: f(M)[:-1], M, eps=1e-4, rtol=1e-4)


@pytest.mark.parametrize(
    "focal, scale",
    [("shared", (1.2, 1.2)), ("first", (1.2, 1)), ("second", (1, 0.8)), ("separate", (1.2, 0.8))],
)
def test_refinement_recovers_exact_focal_lengths(focal, scale):
    K1, K2 = S.K1 @ factor(1 / scale[0]), S.K2 @ factor(1 / scale[1])
    found = refine_focal(*START, S.x1, S.x2, K1, K2, focal=focal, loss_scale=40.0)
    assert bool(found.converged)
    assert found.scale.tolist() == pytest.approx(scale, rel=1e-9)
    assert float(rotation_error(found.R, S.R)) < 1e-9


def test_the_minimum_is_scipys():
    K1, K2 = (K @ factor(1 / 1.2) for K in (S.K1, S.K2))
    x1, x2 = NOISY.x1, NOISY.x2

    def residuals(p: np.ndarray) -> np.ndarray:
        R = torch.from_numpy(Rotation.from_rotvec(p[:3]).as_matrix()) @ S.R
        t = torch.from_numpy(p[3:6] / np.linalg.norm(p[3:6]))
        D = factor(np.exp(p[6]))
        return signed_sampson_distance(fundamental_from_pose(R, t, K1 @ D, K2 @ D), x1, x2).numpy()

    found = refine_focal(*START, x1, x2, K1, K2, loss_scale=0.8)
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    start = np.r_[0, 0, 0, S.t.numpy(), 0.1]
    theirs = least_squares(residuals, start, loss="cauchy", f_scale=0.8, **tight)
    assert float(found.cost[-1]) == pytest.approx(theirs.cost, rel=1e-9)
    assert found.scale.tolist() == pytest.approx([np.exp(theirs.x[6])] * 2, rel=1e-5)


@pytest.mark.grad
def test_derivatives_of_the_minimum():
    few = make_scene(12, noise=0.3)

    def minimum(x1, x2):
        found = refine_focal(few.R, few.t, x1, x2, few.K1, few.K2, loss_scale=2.0)
        return found.R, found.t, found.scale

    start = few.x1.requires_grad_(), few.x2
    assert gradcheck(minimum, start, eps=1e-4, atol=1e-6, rtol=1e-3, fast_mode=True)


def test_the_linearisation_has_the_slope_of_the_cost_by_focal_length_and_distortion():
    linear = linearise_pose(S.R, S.t, NOISY.x1, NOISY.x2, S.K1, S.K2, focal="shared")
    assert linear.score.shape == (60, 7)
    assert linear.by_intrinsics.shape == (7, 8)
    assert not linear.by_intrinsics[:, [0, 3, 4, 7]].any()

    def cost(log_s: float, k1: float) -> torch.Tensor:
        D, K = factor(np.exp(log_s)), (S.K1, S.K2)
        moved = []
        for x, k in zip((NOISY.x1, NOISY.x2), K):
            rays = (torch.nn.functional.pad(x, (0, 1), value=1.0) @ torch.linalg.inv(k).mT)[:, :2]
            # the inverse of a small distortion is the distortion of the opposite sign
            rays = distort(rays, torch.tensor([-k1, 0, 0, 0, 0], dtype=torch.float64))
            moved.append(rays @ k[:2, :2].mT + k[:2, 2])
        F = fundamental_from_pose(S.R, S.t, K[0] @ D, K[1] @ D)
        square = signed_sampson_distance(F, *moved) ** 2
        return 0.5 * loss_terms("cauchy", square, 0.5).value.sum()

    slope = linear.score.sum(0)
    for k, step in enumerate(((1e-6, 0.0), (0.0, 1e-6)), start=5):
        there, back = cost(*step), cost(-step[0], -step[1])
        assert float(slope[k]) == pytest.approx(float(there - back) / 2e-6, rel=2e-2)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="focal must be one of"):
        refine_focal(S.R, S.t, S.x1, S.x2, S.K1, S.K2, focal="both")
    with pytest.raises(DegenerateGeometryError):
        refine_focal(S.R, S.t, S.x1[:6], S.x2[:6], S.K1, S.K2)
