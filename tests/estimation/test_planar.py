"""Homographies from correspondences of which few are right: evidence, options, repeatability."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sfmkit.estimation.planar import estimate_planar, false_alarms
from sfmkit.metrics import corner_error
from sfmkit.options import PlanarOptions
from sfmkit.types import Correspondences, OperatorCounts

H_TRUE = np.array([[0.95, 0.1, 20.0], [-0.08, 1.02, -10.0], [1e-4, -5e-5, 1.0]])
SIZE = (800, 640)


def matches(right, wrong, seed=0, noise=0.3):
    """`right` matches of the plane with distinct ratios below those of `wrong` random ones."""
    rng = np.random.default_rng(seed)
    x1 = rng.uniform([40, 40], [760, 600], (right + wrong, 2))
    y = np.c_[x1, np.ones(len(x1))] @ np.asarray(H_TRUE).T
    x2 = y[:, :2] / y[:, 2:] + rng.normal(0, noise, x1.shape)
    x2[right:] = rng.uniform([0, 0], SIZE, (wrong, 2))
    n = len(x1)
    ratio = np.r_[rng.uniform(0.4, 0.9, right), rng.uniform(0.6, 1.0, wrong)]
    zeros, rows = torch.zeros(n, dtype=torch.int64), torch.arange(n)
    return Correspondences(
        torch.tensor(x1),
        torch.tensor(x2),
        torch.zeros(n, dtype=torch.float64),
        torch.tensor(ratio),
        zeros,
        zeros + 1,
        rows,
        rows,
        ("known",),
        {"known": OperatorCounts((n, n), n)},
    )


@pytest.mark.parametrize("method", ["prefixes", "ransac"])
def test_both_methods_find_the_homography(method):
    corr = matches(300, 200)
    fit = estimate_planar(corr, PlanarOptions(method=method))
    assert corner_error(fit.H.numpy(), H_TRUE, SIZE) < 1
    right = torch.arange(500) < 300
    assert fit.inliers[right].double().mean() > 0.98
    assert fit.inliers[~right].double().mean() < 0.02
    assert fit.H[2, 2] == 1


def test_the_same_seed_gives_the_same_bits():
    corr = matches(100, 900)
    a, b = (estimate_planar(corr, seed=5) for _ in range(2))
    assert torch.equal(a.H, b.H)
    assert a.evidence == b.evidence


def test_matches_without_a_ratio_are_used():
    corr = matches(200, 200)
    object.__setattr__(corr, "ratio", torch.full((400,), float("nan"), dtype=torch.float64))
    assert corner_error(estimate_planar(corr).H.numpy(), H_TRUE, SIZE) < 1


@pytest.mark.parametrize("n", [0, 5, 7])
def test_too_few_matches_give_a_reason(n):
    fit = estimate_planar(matches(n, 0))
    assert fit.H is None
    assert "at least 8" in fit.reason
    assert fit.inliers.shape == (n,)


def test_a_repeated_detail_counts_once():
    corr = matches(30, 0)
    x1, x2 = (x.repeat(20, 1) for x in (corr.x1, corr.x2))
    H = torch.tensor(H_TRUE)
    once = false_alarms(H, corr.x1, corr.x2, 3.0, torch.Generator().manual_seed(0))
    often = false_alarms(H, x1, x2, 3.0, torch.Generator().manual_seed(0))
    assert often["matches"] == once["matches"]
    assert often["inliers"] == once["inliers"]
