"""The verdict on scenes whose answer is known: depth, a plane, a rotation, nothing at all."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sfmkit.errors import InputError
from sfmkit.estimation import estimate_two_view, within_the_field
from sfmkit.estimation.two_view import planar_poses
from sfmkit.geometry.homography import homography_dlt
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.options import EstimateOptions
from sfmkit.types import Camera, Correspondences, OperatorCounts, Verdict

SIZE = (1200, 900)
CAMERA = Camera(np.array([[1000.0, 0, 599.5], [0, 1000.0, 449.5], [0, 0, 1]]), SIZE)


def rotation(axis, degrees):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    a = np.radians(degrees)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


def correspondences(x1, x2):
    n = len(x1)
    zeros = torch.zeros(n, dtype=torch.int64)
    return Correspondences(
        torch.tensor(x1, dtype=torch.float64),
        torch.tensor(x2, dtype=torch.float64),
        torch.zeros(n, dtype=torch.float64),
        torch.full((n,), float("nan"), dtype=torch.float64),
        zeros,
        zeros + 1,
        torch.arange(n),
        torch.arange(n),
        ("known",),
        {"known": OperatorCounts((n, n), n)},
    )


def scene(kind, n=600, noise=0.5, outliers=0.3, seed=0):
    """(correspondences, R, t): pixels of known points with Gaussian noise, and a share of uniformly
    wrong partners."""
    rng = np.random.default_rng(seed)
    R, t = rotation([0.2, 1, 0.1], 8), np.array([-1.0, 0.1, 0.15])
    pixels = rng.uniform([60, 60], [SIZE[0] - 60, SIZE[1] - 60], (n, 2))
    rays = np.c_[pixels, np.ones(n)] @ np.linalg.inv(CAMERA.K).T
    if kind == "plane":
        normal, distance = np.array([0.2, -0.1, 1.0]), 8.0
        depth = distance / (rays @ normal)
    else:
        depth = rng.uniform(5, 12, n)
    X2 = (rays * depth[:, None]) @ R.T + (0 * t if kind == "rotation" else t)
    x2 = X2 @ CAMERA.K.T
    x2 = x2[:, :2] / x2[:, 2:]
    x1, x2 = pixels + rng.normal(0, noise, (n, 2)), x2 + rng.normal(0, noise, (n, 2))
    wrong = rng.random(n) < (1.0 if kind == "nothing" else outliers)
    x2[wrong] = rng.uniform([0, 0], SIZE, (int(wrong.sum()), 2))
    return correspondences(x1, x2), R, t / np.linalg.norm(t)


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def rotation_degrees(A, B):
    D = A.T @ B
    return np.degrees(
        np.arctan2(
            np.linalg.norm([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]),
            np.trace(D) - 1,
        )
    )


OPTIONS = EstimateOptions(threshold_px=1.5)


@pytest.mark.parametrize("seed", range(3))
def test_depth_is_general_and_the_pose_is_right(seed):
    corr, R, t = scene("depth", seed=seed)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS, seed=seed)
    assert view.verdict is Verdict.GENERAL
    assert rotation_degrees(view.R.numpy(), R) < 0.15
    assert degrees_between(view.t.numpy(), t) < 0.8
    assert view.evidence["share_off_plane"] > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_a_plane_is_planar_and_still_has_its_pose(seed):
    corr, R, t = scene("plane", seed=seed)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS, seed=seed)
    assert view.verdict is Verdict.PLANAR
    # A plane seen twice allows two motions, and nothing but the other one: the truth is among them.
    poses = [(view.R, view.t), *view.alternatives]
    assert len(poses) <= 2
    assert (
        min(rotation_degrees(Q.numpy(), R) + degrees_between(u.numpy(), t) / 5 for Q, u in poses)
        < 1.5
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_rotation_has_no_translation_and_no_claim_of_one(seed):
    corr, R, _ = scene("rotation", seed=seed)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS, seed=seed)
    assert view.verdict is Verdict.PURE_ROTATION
    assert view.t is None
    assert view.E is None
    assert rotation_degrees(view.R.numpy(), R) < 0.05


@pytest.mark.parametrize("seed", range(5))
def test_wrong_matches_only_are_too_little(seed):
    corr, _, _ = scene("nothing", seed=seed, n=800)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS, seed=seed)
    assert view.verdict is Verdict.TOO_LITTLE
    assert view.R is None
    assert not view.inliers.any()


def test_seven_matches_are_too_few_to_try():
    corr, _, _ = scene("depth", n=7, outliers=0)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS)
    assert view.verdict is Verdict.TOO_LITTLE
    assert "7 matches" in view.reason


def test_two_cameras_of_different_focal_length():
    corr, R, t = scene("depth", outliers=0.2)
    other = CAMERA.scaled((600, 450))
    half = correspondences(corr.x1.numpy(), (corr.x2.numpy() + 0.5) / 2 - 0.5)
    view = estimate_two_view(half, CAMERA, other, EstimateOptions(threshold_px=1.0))
    assert view.verdict is Verdict.GENERAL
    assert rotation_degrees(view.R.numpy(), R) < 0.2
    assert degrees_between(view.t.numpy(), t) < 1.0


def test_the_fundamental_path_gives_a_pose_too():
    corr, R, _ = scene("depth", noise=0.2, outliers=0.2)
    options = EstimateOptions(
        model="fundamental", backend="opencv", method="ransac", threshold_px=1.5, refine=False
    )
    view = estimate_two_view(corr, CAMERA, CAMERA, options)
    assert view.verdict is Verdict.GENERAL
    assert rotation_degrees(view.R.numpy(), R) < 2


def test_thresholds_must_be_positive():
    with pytest.raises(InputError, match="threshold_px"):
        EstimateOptions(threshold_px=0)


@pytest.mark.parametrize("seed", [12, 18])
def test_unknown_distance_ratios_do_not_mislead_the_search(seed):
    """Where no match knows its ratio, their order is arbitrary: the search must not follow
    it."""
    corr, R, _ = scene("depth", n=500, outliers=0.75, seed=seed)
    view = estimate_two_view(corr, CAMERA, CAMERA, OPTIONS, seed=seed)
    assert view.verdict is Verdict.GENERAL
    assert rotation_degrees(view.R.numpy(), R) < 0.5


def test_points_outside_the_field_of_the_distortion_are_dropped_and_counted():
    """r (1 + k1 r^2) is largest, at 2 r / 3, where 1 + 3 k1 r^2 = 0: no ray is seen farther out."""
    k1 = -0.27
    farthest = 2 / 3 * np.sqrt(-1 / (3 * k1))
    camera = Camera(np.array([[400.0, 0, 383.5], [0, 400, 255.5], [0, 0, 1]]), (768, 512), [k1])
    radius = farthest * np.array([0, 0.5, 0.98, 1.02, 1.1, 0.9])
    angle = np.arange(6.0)
    x = camera.K[:2, 2] + 400 * radius[:, None] * np.c_[np.cos(angle), np.sin(angle)]
    inner = np.full((6, 2), [383.5, 255.5])
    for pair in ((x, inner), (inner, x)):
        with pytest.warns(UserWarning, match="2 of 6 correspondences .* were dropped"):
            kept = within_the_field(correspondences(*pair), camera, camera)
        assert kept.index1.tolist() == [0, 1, 2, 5]
    corr = correspondences(inner, inner)
    assert within_the_field(corr, camera, camera) is corr


def plane_seen_twice(g):
    """Return pixels of a random plane in two views and the motion, or None if a point is behind."""
    K = torch.tensor(CAMERA.K)
    R, t = rotation(g.normal(size=3), g.normal(0, 20)), g.normal(size=3)
    t *= g.uniform(0.2, 1) / np.linalg.norm(t)
    normal = np.array([*g.uniform(-0.6, 0.6, 2), 1])
    u = g.uniform((0, 0), SIZE, (400, 2))
    rays = np.c_[u, np.ones(400)] @ np.linalg.inv(CAMERA.K).T
    X = rays * (4 / (rays @ normal))[:, None]
    Y = X @ R.T + t
    if min(X[:, 2].min(), Y[:, 2].min()) < 0.1:
        return None
    v = Y @ CAMERA.K.T
    noise = g.choice([0.3, 1.0, 2.0])
    x1, x2 = (torch.tensor(x + g.normal(0, noise, x.shape)) for x in (u, v[:, :2] / v[:, 2:]))
    t = t / np.linalg.norm(t)
    return x1, x2, K, torch.tensor(R), torch.tensor(t), noise


def test_the_true_pose_of_a_plane_is_a_candidate():
    g = np.random.default_rng(0)
    scenes = [scene for scene in (plane_seen_twice(g) for _ in range(80)) if scene]
    assert len(scenes) > 40
    everything = torch.ones(400, dtype=torch.bool)
    for x1, x2, K, R, t, noise in scenes:
        H = homography_dlt(x1, x2)
        unrelated = torch.eye(3, dtype=torch.float64), t.roll(1)
        found = planar_poses(H, unrelated, x1, x2, K, K, everything, threshold_px=2.0)
        assert 1 <= len(found) <= 3  # two of the plane, and the start
        errors = [float(rotation_error(Q, R) + translation_error(q, t)) for Q, q in found]
        assert min(errors) < 10 * noise, errors
