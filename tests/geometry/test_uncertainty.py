"""Covariances compared with a dense inverse, and the coverage of their confidence regions."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene
from scipy.stats import f as fisher

from sfmkit.errors import DegenerateGeometryError
from sfmkit.geometry.bundle import bundle_adjust
from sfmkit.geometry.lie import so3_exp, so3_log, sphere_exp, tangent_basis
from sfmkit.geometry.reprojection import project, reprojection_residuals
from sfmkit.geometry.uncertainty import covariance, sigma_degrees

D = torch.float64

# matches, noise (px), rotation vector, translation, depth in baselines
GEOMETRIES = [
    (60, 0.5, (0.02, -0.1, 0.01), (1.0, 0.1, -0.1), 4.0),
    (150, 1.0, (0.1, 0.2, -0.05), (-1.0, 0.3, 0.2), 3.0),
    (300, 0.3, (0.0, 0.05, 0.0), (0.3, 0.1, 1.0), 3.0),
    (100, 0.7, (0.3, -0.2, 0.4), (0.1, 1.0, 0.1), 5.0),
    (80, 0.2, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 8.0),
]


def normalised_errors(
    trials: int, seed: int, geometry: tuple
) -> tuple[torch.Tensor, torch.Tensor, int]:
    """Return the squared normalised errors of pose (trials,) and points (trials, N).

    They are divided by the dimensions, 5 and 3.
    """
    n, noise, tilt, direction, depth = geometry
    g = torch.Generator().manual_seed(seed)
    K = torch.tensor([[1000.0, 0, 640], [0, 1000, 480], [0, 0, 1]], dtype=D).expand(trials, 3, 3)
    ray = torch.rand(trials, n, 2, generator=g, dtype=D) * torch.tensor([1.2, 0.9]) - torch.tensor(
        [0.6, 0.45]
    )
    z = depth * (0.6 + 0.8 * torch.rand(trials, n, 1, generator=g, dtype=D))
    X = torch.cat((ray * z, z), -1)
    R = so3_exp(torch.tensor(tilt, dtype=D)).expand(trials, 3, 3)
    t = torch.nn.functional.normalize(torch.tensor(direction, dtype=D), dim=0).expand(trials, 3)
    x1, x2 = (
        x + noise * torch.randn(x.shape, generator=g, dtype=D)
        for x in (project(X, K), project(X, K, R, t))
    )
    b = bundle_adjust(x1, x2, K, K, R, t)
    assert bool(b.converged.all())
    c = covariance(b)
    assert float(c.sigma_px.mean()) == pytest.approx(noise, rel=0.05)
    along = ((t * b.t).sum(-1, keepdim=True)).clamp(-1, 1)
    towards = t - along * b.t
    turn = torch.nn.functional.normalize(towards, dim=-1) * torch.atan2(
        towards.norm(dim=-1, keepdim=True), along
    )
    e = torch.cat((so3_log(R @ b.R.mT), (tangent_basis(b.t).mT @ turn[..., None])[..., 0]), -1)
    pose = (e * torch.linalg.solve(c.pose, e)).sum(-1) / 5
    points = ((X - b.X) * torch.linalg.solve(c.points, X - b.X)).sum(-1) / 3
    assert int(c.degrees_of_freedom[0]) == n - 5
    return pose, points, n - 5


def coverage(trials: int) -> dict[float, tuple[float, float]]:
    """Return the share of trials whose truth lies in the region of each level: pose, points."""
    inside: dict[float, tuple[list, list]] = {0.68: ([], []), 0.95: ([], [])}
    for seed, geometry in enumerate(GEOMETRIES):
        pose, points, dof = normalised_errors(trials, seed, geometry)
        for level, (poses, clouds) in inside.items():
            # The noise is estimated too: Fisher's distribution instead of chi squared.
            poses.append(pose < fisher.ppf(level, 5, dof))
            clouds.append((points < fisher.ppf(level, 3, dof)).flatten())
    return {
        level: (float(torch.cat(a).double().mean()), float(torch.cat(b).double().mean()))
        for level, (a, b) in inside.items()
    }


@pytest.mark.slow
def test_confidence_regions_have_the_expected_coverage():
    share = coverage(200)  # a thousand trials
    assert share[0.68] == pytest.approx((0.68, 0.68), abs=0.04)
    assert share[0.95] == pytest.approx((0.95, 0.95), abs=0.02)


def test_few_trials_have_about_the_expected_coverage():
    share = coverage(20)  # a hundred trials: standard deviations of 0.047 and 0.022
    assert share[0.68] == pytest.approx((0.68, 0.68), abs=0.14)
    assert share[0.95] == pytest.approx((0.95, 0.95), abs=0.065)


def test_covariance_is_the_inverse_of_the_whole_normal_matrix():
    s = make_scene(20, noise=0.5)
    w = torch.linspace(0.5, 2, 20, dtype=D)
    b = bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, w)
    c = covariance(b)

    def residuals(p: torch.Tensor, X: torch.Tensor) -> torch.Tensor:
        R, t = so3_exp(p[:3]) @ b.R, sphere_exp(b.t, tangent_basis(b.t) @ p[3:])
        return (
            w.sqrt()[:, None] * reprojection_residuals(X, s.x1, s.x2, s.K1, s.K2, R, t)
        ).flatten()

    zero = torch.zeros(5, dtype=D)
    by_pose, by_points = torch.func.jacrev(residuals, (0, 1))(zero, b.X)
    J = torch.cat((by_pose, by_points.flatten(1)), 1)
    variance = residuals(zero, b.X).square().sum() / 15
    full = variance * torch.linalg.inv(J.T @ J)
    torch.testing.assert_close(c.sigma_px**2, variance)
    torch.testing.assert_close(c.pose, full[:5, :5], rtol=1e-6, atol=1e-15)
    blocks = torch.stack([full[k : k + 3, k : k + 3] for k in range(5, 65, 3)])
    torch.testing.assert_close(c.points, blocks, rtol=1e-6, atol=1e-12)
    expected = torch.rad2deg(torch.stack((full[:3, :3].trace(), full[3:5, 3:5].trace())).sqrt())
    torch.testing.assert_close(c.sigma_deg, expected, rtol=1e-6, atol=0)
    torch.testing.assert_close(sigma_degrees(c.pose), c.sigma_deg)


@pytest.mark.parametrize("loss, scale", [("huber", 1.0), ("cauchy", 2.0)])
def test_a_robust_loss_estimates_the_noise_too(loss, scale):
    s = make_scene(400, noise=0.5)
    squared = covariance(bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t))
    robust = covariance(
        bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, loss=loss, loss_scale=scale)
    )
    assert float(robust.sigma_px) == pytest.approx(0.5, rel=0.1)
    torch.testing.assert_close(robust.sigma_deg, squared.sigma_deg, rtol=0.15, atol=0)


def test_a_free_focal_length_increases_the_uncertainty():
    s = make_scene(200, noise=0.5)
    fixed = covariance(bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t))
    free = covariance(bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, focal="separate"))
    assert bool((free.sigma_deg > fixed.sigma_deg).all())
    assert int(free.degrees_of_freedom) == 193


def scene_tensors(seeds):
    scenes = [make_scene(30, noise=0.5, seed=seed) for seed in seeds]
    return [torch.stack(a) for a in zip(*((s.x1, s.x2, s.K1, s.K2, s.R, s.t) for s in scenes))]


def of_matches(*tensors):
    c = covariance(bundle_adjust(*tensors))
    return c.pose, c.points, c.sigma_px


def test_a_batch_and_vmap_agree_with_single_problems():
    tensors = scene_tensors(range(2))
    single = [torch.stack(a) for a in zip(*(of_matches(*a) for a in zip(*tensors)))]
    for batch in (of_matches(*tensors), torch.func.vmap(of_matches)(*tensors)):
        for one, many in zip(single, batch):
            # The order of the sums depends on the processor: the minimum differs by about 1e-8.
            torch.testing.assert_close(many, one, rtol=1e-5, atol=1e-5 * float(one.abs().max()))


def test_vmap_gives_nan_where_the_pose_is_undetermined():
    x1, x2, *cameras = scene_tensors(range(2))
    x1[1], x2[1] = x1[1, :1], x2[1, :1]  # one match thirty times
    pose, points, _ = torch.func.vmap(of_matches)(x1, x2, *cameras)
    assert pose[0].isfinite().all()
    assert points[0].isfinite().all()
    assert pose[1].isnan().all()


@pytest.mark.grad
@pytest.mark.parametrize("loss", ["squared", "cauchy"])
def test_the_covariance_has_the_derivatives_of_finite_differences(loss):
    s = make_scene(12, noise=0.3)

    def scaled(x2, w):  # of the order of one
        b = bundle_adjust(s.x1, x2, s.K1, s.K2, s.R, s.t, w, loss=loss)
        c = covariance(b)
        return 1e6 * c.pose, c.points, c.sigma_px

    values = (s.x2.requires_grad_(), torch.linspace(0.8, 1.2, 12, dtype=D).requires_grad_())
    assert torch.autograd.gradcheck(scaled, values, eps=1e-4, atol=1e-3, rtol=1e-3, fast_mode=True)


def test_an_undetermined_problem_raises():
    s = make_scene(5, noise=0.5)
    with pytest.raises(DegenerateGeometryError, match="no degrees of freedom"):
        covariance(bundle_adjust(s.x1, s.x2, s.K1, s.K2, s.R, s.t, max_iterations=3))
    one = make_scene(1)
    x1, x2 = one.x1.expand(10, 2), one.x2.expand(10, 2)  # one match ten times
    with pytest.raises(DegenerateGeometryError, match="do not determine the pose"):
        covariance(bundle_adjust(x1, x2, s.K1, s.K2, s.R, s.t, max_iterations=3))


def test_points_at_infinity_do_not_affect_the_others():
    s = make_scene(30)
    ray = torch.tensor([0.1, 0.05, 1.0], dtype=D)  # two pixels that see one direction
    far1, far2 = s.K1 @ ray, s.K2 @ s.R @ ray
    x1, x2 = s.x1.clone(), s.x2.clone()
    x1[0], x2[0] = far1[:2] / far1[2], far2[:2] / far2[2]
    b = bundle_adjust(x1, x2, s.K1, s.K2, s.R, s.t)
    assert abs(float(b.inverse_depth[0, 2])) < 1e-12
    c = covariance(b)
    assert not b.X.isnan().any()
    assert c.pose.isfinite().all()
    assert c.points[1:].isfinite().all()
    assert float(c.points[0, 2, 2]) > 1e6 * float(c.points[1:, 2, 2].max())
