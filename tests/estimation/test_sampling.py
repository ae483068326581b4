"""Samples of the robust search: distinct matches, the right order, the right probabilities."""

from __future__ import annotations

import math

import pytest
import torch

from sfmkit.estimation._sampling import Sampler


def sampler(n, size=4, seed=0, weights=None, quality=None, groups=None):
    return Sampler(n, size, torch.Generator().manual_seed(seed), weights, quality, groups)


@pytest.mark.parametrize("n", [6, 300, 5000])
def test_samples_hold_distinct_matches(n):
    samples = sampler(n).draw(500)
    assert samples.shape[1] == 4
    assert len(samples) > 400
    assert samples.min() >= 0
    assert samples.max() < n
    ascending = samples.sort(dim=1).values
    assert (ascending[:, 1:] != ascending[:, :-1]).all()


def test_the_same_seed_gives_the_same_samples():
    assert torch.equal(sampler(1000, seed=3).draw(64), sampler(1000, seed=3).draw(64))
    assert not torch.equal(sampler(1000, seed=3).draw(64), sampler(1000, seed=4).draw(64))


def test_rounds_draw_from_longer_and_longer_prefixes_of_the_quality():
    quality = torch.rand(5000, generator=torch.Generator().manual_seed(1))
    order = quality.argsort()
    s = sampler(5000, quality=quality)
    for most in (100, 300, 1000, 3000, 5000):
        samples = s.draw(256)
        assert torch.isin(samples, order[:most]).all()


def test_quality_without_a_finite_value_is_ignored():
    s = sampler(5000, quality=torch.full((5000,), float("nan")))
    assert s.draw(256).max() > 3000


def test_a_match_of_weight_zero_is_never_drawn():
    weights = torch.ones(800)
    weights[::2] = 0
    assert (sampler(800, weights=weights).draw(500) % 2 == 1).all()


def test_a_group_with_more_inliers_is_drawn_more():
    groups = torch.arange(2000) % 2
    s = sampler(2000, groups=groups)
    s.learn(groups == 1)
    share = float((groups[s.draw(2000)] == 1).double().mean())
    assert share > 0.99


def test_the_probability_to_have_missed_a_good_sample_is_the_product_over_rounds():
    s = sampler(1000)
    s.draw(64)
    s.draw(256)
    inliers = torch.zeros(1000, dtype=torch.bool)
    inliers[:500] = True
    expected = (64 + 256) * math.log1p(-(0.5**4))
    assert s.log_missed(inliers) == pytest.approx(expected, rel=1e-6)
