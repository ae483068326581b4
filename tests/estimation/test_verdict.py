"""The parts of the verdict against closed forms and counts over all wrong partners."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import gammaln

from sfmkit.estimation import estimate_two_view
from sfmkit.estimation.verdict import (
    chance_agreement,
    fit_rotation,
    gric,
    log10_nfa,
    nearest_rotation,
    rotate_pixels,
)
from sfmkit.geometry.fundamental import fundamental_from_pose, squared_sampson_distance
from sfmkit.types import Camera, Correspondences, OperatorCounts, Verdict

SIZE = (1000, 750)
K = torch.tensor([[800.0, 0, 499.5], [0, 800.0, 374.5], [0, 0, 1]], dtype=torch.float64)
R = torch.tensor(Rotation.from_euler("y", 3, degrees=True).as_matrix())
T = torch.nn.functional.normalize(torch.tensor([-0.5, 0.1, 0.1], dtype=torch.float64), dim=0)
F = fundamental_from_pose(R, T, K, K)


def exact_matches(n, seed=0):
    """(n, 2) pixels of n points with depth in both images."""
    rng = np.random.default_rng(seed)
    X = torch.tensor(rng.uniform([-2, -1.5, 4], [2, 1.5, 12], (20 * n, 3)))
    y1, y2 = X @ K.mT, (X @ R.mT + T) @ K.mT
    x1, x2 = y1[:, :2] / y1[:, 2:], y2[:, :2] / y2[:, 2:]
    size = torch.tensor(SIZE)
    seen = ((x1 > 0) & (x1 < size) & (x2 > 0) & (x2 < size)).all(1)
    return x1[seen][:n], x2[seen][:n]


def correspondences(x1, x2):
    n = len(x1)
    zeros, rows = torch.zeros(n, dtype=torch.int64), torch.arange(n)
    distance, ratio = torch.zeros(n, dtype=torch.float64), torch.full((n,), 0.8).double()
    counts = {"known": OperatorCounts((n, n), n)}
    return Correspondences(
        x1, x2, distance, ratio, zeros, zeros + 1, rows, rows, ("known",), counts
    )


@pytest.mark.parametrize("n", [8, 12, 15, 100])
def test_chance_agreement_counts_wrong_partners_only(n):
    x1, x2 = exact_matches(n)
    agree = [squared_sampson_distance(F, x1, x2.roll(k, 0)) < 1 for k in range(1, n)]
    share = float(torch.stack(agree).double().mean())  # over every wrong partner
    measured = chance_agreement(
        lambda a, b: squared_sampson_distance(F, a, b), x1, x2, 1.0, torch.Generator()
    )
    wrong = n * (n - 1)  # fewer than the trials, so that all of them are tried
    assert measured == pytest.approx((share * wrong + 1) / (wrong + 1))


@pytest.mark.parametrize("n", [12, 15, 20])
@pytest.mark.parametrize("seed", range(4))
def test_few_exact_matches_of_a_scene_with_depth_are_accepted(n, seed):
    camera = Camera(K.numpy(), SIZE)
    view = estimate_two_view(correspondences(*exact_matches(n, seed)), camera, camera)
    assert view.verdict is Verdict.GENERAL
    assert view.evidence["log10_false_alarms"] < (-6 if n == 12 else -10)


@pytest.mark.parametrize("seed", range(6))
def test_few_random_matches_are_rejected(seed):
    g = torch.Generator().manual_seed(seed)
    x1, x2 = (torch.rand(15, 2, generator=g).double() * torch.tensor(SIZE) for _ in range(2))
    camera = Camera(K.numpy(), SIZE)
    view = estimate_two_view(correspondences(x1, x2), camera, camera)
    assert view.verdict is Verdict.TOO_LITTLE


def test_the_number_of_false_alarms_is_the_formula():
    n, k, p, sample, solutions = 50, 20, 0.03, 5, 10

    def log_choose(a, b):
        return gammaln(a + 1) - gammaln(b + 1) - gammaln(a - b + 1)

    expected = (
        math.log(solutions * (n - sample))
        + log_choose(n, k)
        + log_choose(k, sample)
        + (k - sample) * math.log(p)
    ) / math.log(10)
    assert log10_nfa(k, n, p, sample, solutions) == pytest.approx(expected)
    assert log10_nfa(sample, n, p, sample, solutions) == math.inf


def test_gric_of_residuals_within_and_beyond_the_limit():
    squared = torch.tensor([0.0, 0.5, 100.0], dtype=torch.float64)
    # dimension 3: residuals count up to 2, dimension 2: up to 4
    assert gric(squared, 1.0, 3, 5) == pytest.approx(0.5 + 2 + math.log(4) * 9 + math.log(12) * 5)
    assert gric(squared, 1.0, 2, 8) == pytest.approx(0.5 + 4 + math.log(4) * 6 + math.log(12) * 8)


def test_the_rotation_is_found_in_spite_of_wrong_matches():
    truth = torch.tensor(Rotation.from_rotvec([0.05, -0.1, 0.02]).as_matrix())
    g = torch.Generator().manual_seed(0)
    x1 = torch.rand(200, 2, generator=g).double() * torch.tensor(SIZE)
    x2 = rotate_pixels(truth, x1, K, K)
    x2[:40] += 200 * torch.rand(40, 2, generator=g).double()
    start = torch.tensor(Rotation.from_rotvec([0.05, -0.095, 0.02]).as_matrix())
    found = fit_rotation(x1, x2, K, K, start, scale_px=0.5)
    torch.testing.assert_close(found, truth, atol=1e-4, rtol=0)


def test_the_nearest_rotation_is_scipys():
    A = torch.tensor(np.random.default_rng(0).normal(size=(3, 3)))
    A = A * torch.sign(torch.det(A))
    expected = Rotation.from_matrix(A.numpy()).as_matrix()
    torch.testing.assert_close(nearest_rotation(-2 * A), torch.tensor(expected))
