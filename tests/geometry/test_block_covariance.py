"""Block jackknife and camera covariance against Monte Carlo and automatic differentiation."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import DegenerateGeometryError, InputError
from sfmkit.geometry.block_covariance import (
    camera_covariance,
    image_blocks,
    jackknife_covariance,
    linearise_pose,
    point_covariances,
    point_derivatives,
)
from sfmkit.geometry.fundamental import fundamental_from_pose
from sfmkit.geometry.lie import so3_exp, so3_log, sphere_exp, tangent_basis
from sfmkit.geometry.refinement import refine_essential
from sfmkit.geometry.triangulation import triangulate

SIZE = (640, 480)


def deviations(R, t, scene):
    """Return deviations (*B, 5) of estimates from the truth in the covariance parameters."""
    omega = so3_log(R @ scene.R.mT)
    b = (tangent_basis(scene.t).mT @ (t / t.norm(dim=-1, keepdim=True))[..., None])[..., 0]
    return torch.cat((omega, b), -1)


def trials(scene, noise, count, loss_scale=2.0):
    """Estimate poses from `count` noisy copies of the scene; return them with the noisy pixels."""
    x1, x2 = scene.x1 + noise(count, 0), scene.x2 + noise(count, 1)
    K1, K2 = scene.K1.expand(count, 3, 3), scene.K2.expand(count, 3, 3)
    start = scene.R.expand(count, 3, 3), scene.t.expand(count, 3)
    refined = refine_essential(*start, x1, x2, K1, K2, loss_scale=loss_scale)
    return refined.R, refined.t, x1, x2


def mean_covariances(scene, R, t, x1, x2, blocks, count=40):
    found = []
    for k in range(count):
        s = linearise_pose(R[k], t[k], x1[k], x2[k], scene.K1, scene.K2, loss_scale=2.0)
        found.append(jackknife_covariance(s, blocks))
    return torch.stack(found).mean(0)


def ratio(estimated, errors):
    """Return the square root of the mean ratio of variances over the five parameters."""
    return float((estimated.diagonal() / errors.square().mean(0)).mean().sqrt())


def test_independent_noise_gives_the_classical_covariance():
    scene = make_scene(400)
    g = torch.Generator().manual_seed(1)

    def noise(count, image):
        return 0.4 * torch.randn(count, 400, 2, generator=g, dtype=torch.float64)

    R, t, x1, x2 = trials(scene, noise, 300)
    blocks = image_blocks(scene.x1, SIZE)
    estimated = mean_covariances(scene, R, t, x1, x2, blocks)
    assert 0.9 < ratio(estimated, deviations(R, t, scene)) < 1.2


def test_noise_shared_by_a_tile_increases_the_block_covariance_only():
    scene = make_scene(1200)
    blocks = image_blocks(scene.x1, SIZE)
    _, tile = torch.unique(blocks, return_inverse=True)
    g = torch.Generator().manual_seed(2)

    def noise(count, image):
        shared = torch.randn(count, int(tile.max()) + 1, 2, generator=g, dtype=torch.float64)
        own = torch.randn(count, 1200, 2, generator=g, dtype=torch.float64)
        return 0.3 * shared[:, tile] + 0.2 * own

    R, t, x1, x2 = trials(scene, noise, 300)
    errors = deviations(R, t, scene)
    by_tile = mean_covariances(scene, R, t, x1, x2, blocks)
    by_match = mean_covariances(scene, R, t, x1, x2, torch.arange(1200))
    assert 0.85 < ratio(by_tile, errors) < 1.25
    assert ratio(by_match, errors) < 0.6


@pytest.mark.parametrize("shared", [True, False])
def test_errors_of_the_cameras_change_the_pose_as_predicted(shared):
    scene = make_scene(400)
    sigma1 = torch.tensor([0.004, 1.5, 1.0, 0.002], dtype=torch.float64)
    sigma2 = sigma1 if shared else sigma1 * 1.5
    s = linearise_pose(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2)
    predicted = camera_covariance(s, sigma1, sigma2, shared)
    g = torch.Generator().manual_seed(3)
    count = 400
    d1 = torch.randn(count, 4, generator=g, dtype=torch.float64) * sigma1
    d2 = d1 if shared else torch.randn(count, 4, generator=g, dtype=torch.float64) * sigma2
    (K1, x1), (K2, x2) = (
        disturbed(K, x, d) for K, x, d in ((scene.K1, scene.x1, d1), (scene.K2, scene.x2, d2))
    )
    start = scene.R.expand(count, 3, 3), scene.t.expand(count, 3)
    # every match has its full weight, whatever its residual under a wrong camera
    refined = refine_essential(*start, x1, x2, K1, K2, loss="squared")
    errors = deviations(refined.R, refined.t, scene)
    measured = errors.mT @ errors / count
    scale = predicted.diagonal().sqrt()
    correlation = (measured - predicted) / scale[:, None] / scale
    assert correlation.abs().max() < 0.2, correlation


def test_derivatives_of_points_with_respect_to_pose_and_cameras():
    """Compare with automatic differentiation through the cameras."""
    scene = make_scene(20)
    found = point_derivatives(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2)

    def points(theta):
        R = so3_exp(theta[:3]) @ scene.R
        t = sphere_exp(scene.t, tangent_basis(scene.t) @ theta[3:5])
        xn1, xn2 = (
            normalised(K, x, d)
            for K, x, d in (
                (scene.K1, scene.x1, theta[5:9]),
                (scene.K2, scene.x2, theta[9:]),
            )
        )
        return triangulate(xn1, xn2, R, t)

    def normalised(K, x, d):
        moved, shifted = disturbed(K, x, d[None])
        one = torch.ones(len(x), 1, dtype=x.dtype)
        return (torch.cat((shifted[0], one), 1) @ torch.linalg.inv(moved[0]).mT)[:, :2]

    expected = torch.autograd.functional.jacobian(points, torch.zeros(13, dtype=torch.float64))
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


def test_covariances_of_points_include_the_parts_of_the_pose():
    scene = make_scene(30)
    sensitivity = linearise_pose(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2)
    by = point_derivatives(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2)
    g = torch.Generator().manual_seed(4)
    local = torch.eye(3, dtype=torch.float64).expand(30, 3, 3)
    before, after = (a @ a.mT for a in torch.randn(2, 5, 5, generator=g, dtype=torch.float64))
    sigma = torch.tensor([0.01, 2.0, 2.0, 0.01], dtype=torch.float64)
    included = local + by[..., :5] @ before @ by[..., :5].mT
    found = point_covariances(included, by, before, after, sensitivity, sigma, sigma, False)
    direct = by[..., 5:] + by[..., :5] @ sensitivity.by_intrinsics
    spread = torch.diag(torch.cat((sigma, sigma)).square())
    expected = local + by[..., :5] @ after @ by[..., :5].mT + direct @ spread @ direct.mT
    torch.testing.assert_close(found, expected)


def disturbed(K, x, d):
    """Return cameras (B, 3, 3) and undistorted pixels (B, N, 2) for errors d (B, 4)."""
    focal, centre = torch.zeros(2, 3, 3, dtype=K.dtype)
    focal[:2, :2] = K[:2, :2]
    centre[:2, 2] = 1
    shift = torch.cat((d[:, 1:3], torch.zeros_like(d[:, :1])), 1)[:, :, None]
    moved = K + d[:, :1, None] * focal + shift * centre
    xn = (torch.cat((x, torch.ones(len(x), 1, dtype=x.dtype)), 1) @ torch.linalg.inv(K).mT)[:, :2]
    shift = -d[:, 3, None, None] * xn.square().sum(-1, keepdim=True) * xn
    return moved, x + shift @ K[:2, :2].mT


def test_scores_are_the_gradients_of_the_cost():
    scene = make_scene(30, noise=0.7)
    s = linearise_pose(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2, loss_scale=0.5)

    def cost(theta):
        R = so3_exp(theta[:3]) @ scene.R
        t = sphere_exp(scene.t, tangent_basis(scene.t) @ theta[3:])
        F = fundamental_from_pose(R, t, scene.K1, scene.K2)
        one = torch.ones(30, 1, dtype=torch.float64)
        y1, y2 = torch.cat((scene.x1, one), 1), torch.cat((scene.x2, one), 1)
        l2, l1 = y1 @ F.mT, y2 @ F
        q = l2[:, :2].square().sum(1) + l1[:, :2].square().sum(1)
        square = (y2 * l2).sum(1).square() / q
        return 0.5 * 0.25 * torch.log1p(square / 0.25)

    expected = torch.func.jacrev(cost)(torch.zeros(5, dtype=torch.float64))
    torch.testing.assert_close(s.score, expected, rtol=1e-8, atol=1e-8)


def test_too_few_blocks_leave_the_pose_undetermined():
    scene = make_scene(50, noise=0.3)
    s = linearise_pose(scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2)
    one = torch.zeros(50, dtype=torch.int64)
    assert torch.isinf(jackknife_covariance(s, one)).all()


def test_tiles_have_the_stated_size():
    x = torch.tensor([[0.0, 0.0], [255.9, 0.0], [256.1, 0.0], [3071.0, 2047.0]])
    blocks = image_blocks(x, (3072, 2048))
    assert blocks[0] == blocks[1] != blocks[2]
    assert blocks[3] == 7 * 12 + 11


def with_nan(a):
    return a.clone().index_fill(0, torch.tensor(0), torch.nan)


SCENE = make_scene(12, noise=0.3)
VIEWS = (SCENE.R, SCENE.t, SCENE.x1, SCENE.x2, SCENE.K1, SCENE.K2)
LINEAR = linearise_pose(*VIEWS)
BLOCKS = torch.arange(12)
SIGMA = torch.ones(4, dtype=torch.float64)


@pytest.mark.parametrize(
    "call",
    [
        lambda: linearise_pose(*VIEWS, loss="none"),
        lambda: linearise_pose(*VIEWS, loss_scale=0.0),
        lambda: linearise_pose(SCENE.R, 0 * SCENE.t, *VIEWS[2:]),
        lambda: linearise_pose(SCENE.R.expand(2, 3, 3), *VIEWS[1:]),
        lambda: linearise_pose(*VIEWS[:2], SCENE.x1[:6], *VIEWS[3:]),
        lambda: point_derivatives(*VIEWS[:3], with_nan(SCENE.x2), *VIEWS[4:]),
        lambda: jackknife_covariance(LINEAR, torch.zeros(12)),
        lambda: jackknife_covariance(LINEAR, torch.zeros(11, dtype=torch.int64)),
        lambda: jackknife_covariance(
            replace(LINEAR, score=with_nan(LINEAR.score)), torch.arange(12)
        ),
        lambda: camera_covariance(LINEAR, -SIGMA, SIGMA, True),
        lambda: camera_covariance(LINEAR, SIGMA[:3], SIGMA, True),
        lambda: camera_covariance(replace(LINEAR, hessian=LINEAR.score), SIGMA, SIGMA, True),
        lambda: image_blocks(SCENE.x1, (0, 0)),
        lambda: image_blocks(SCENE.x1, SIZE, 0),
        lambda: image_blocks(with_nan(SCENE.x1), SIZE),
    ],
)
def test_bad_input_is_rejected(call):
    with pytest.raises(InputError, match=r".+"):
        call()


def test_matches_that_do_not_determine_the_pose_are_rejected():
    with pytest.raises(DegenerateGeometryError, match="4 points are too few"):
        linearise_pose(*VIEWS[:2], SCENE.x1[:4], SCENE.x2[:4], *VIEWS[4:])
    same = torch.zeros(12, dtype=torch.int64)
    with pytest.raises(DegenerateGeometryError, match="do not determine the pose"):
        linearise_pose(*VIEWS[:2], SCENE.x1[same], SCENE.x2[same], *VIEWS[4:])


def test_points_outside_the_image_belong_to_the_nearest_tile():
    x = torch.tensor([[-5.0, -1e300], [1e300, 1e300]], dtype=torch.float64)
    assert image_blocks(x, SIZE).tolist() == [0, 143]
