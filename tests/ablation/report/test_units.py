"""Scenes as the units of intervals and tests, against a bootstrap by loops and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sfmkit.ablation.report.differences import differences
from sfmkit.ablation.report.intervals import mean_interval, median_interval, share_best
from sfmkit.ablation.report.units import choose_units
from sfmkit.errors import InputError


def test_intervals_over_scenes_are_those_of_a_plain_bootstrap_of_scenes():
    """BCa by loops over scenes of unequal size, each drawn with all of its pairs."""
    rng = np.random.default_rng(8)
    of_pair = np.repeat(np.arange(9), [3, 5, 1, 4, 4, 2, 6, 3, 5])
    values = rng.gamma(2, 0.2, 9)[of_pair] + rng.normal(0, 0.03, len(of_pair))
    scenes = [values[of_pair == k] for k in range(9)]
    means = []
    for _ in range(10_000):
        drawn = np.concatenate([scenes[k] for k in rng.integers(0, 9, 9)])
        means.append(drawn.mean())
    z0 = stats.norm.ppf(np.mean(np.array(means) < values.mean()))
    jackknife = np.array([values[of_pair != k].mean() for k in range(9)])
    away = jackknife.mean() - jackknife
    a = (away**3).sum() / (6 * (away**2).sum() ** 1.5)
    z = z0 + stats.norm.ppf([0.025, 0.975])
    expected = np.quantile(means, stats.norm.cdf(z0 + z / (1 - a * z)))
    found = mean_interval(values[:, None], of_pair, draws=10_000)
    assert found.value[0] == pytest.approx(values.mean())
    assert (found.low[0], found.high[0]) == pytest.approx(tuple(expected), rel=0.03)
    by_pair = mean_interval(values[:, None])
    assert found.high[0] - found.low[0] > 1.3 * (by_pair.high[0] - by_pair.low[0])


def test_intervals_over_scenes_cover_the_truth_where_those_over_pairs_do_not():
    """20 scenes of 4 pairs whose scores are correlated by 0.8; the true mean is 1."""
    rng = np.random.default_rng(3)
    of_pair, trials = np.repeat(np.arange(20), 4), 1000
    scene, pair = rng.normal(0, 0.9, (20, trials)), rng.normal(0, 0.45, (80, trials))
    values = 1 + scene[of_pair] + pair
    covered = {}
    for name, units in (("scenes", of_pair), ("pairs", None)):
        _, low, high = mean_interval(values, units, draws=1000)
        covered[name] = ((low <= 1) & (high >= 1)).mean()
    assert 0.90 <= covered["scenes"] <= 0.97
    assert covered["pairs"] < 0.75


def test_scenes_of_one_pair_give_the_numbers_of_pairs():
    values = np.random.default_rng(4).normal(size=(12, 3, 2))
    each = np.arange(12)
    for a, b in zip(median_interval(values, each), median_interval(values)):
        assert np.array_equal(a, b)
    q = values.mean(2)
    assert np.array_equal(share_best(q, each), share_best(q))
    assert share_best(q, np.repeat([0, 1, 2], 4)).sum() == pytest.approx(1)


def test_a_scene_counts_once_in_the_signed_rank_test():
    rng = np.random.default_rng(6)
    of_pair = np.repeat(np.arange(10), 5)
    d = rng.normal(0.1, 0.2, 10)[of_pair] + rng.normal(0, 0.01, 50)
    (found,) = differences(np.stack([d, np.zeros(50)], axis=1), [(0, 1)], of_pair)
    means = [np.mean(d[of_pair == k]) for k in range(10)]
    assert found.p == pytest.approx(stats.wilcoxon(means, method="exact").pvalue, rel=1e-9)
    assert (found.better, found.worse) == ((d > 0).sum(), (d < 0).sum())


def test_scenes_are_the_units_if_there_are_five():
    few, many = choose_units(["a", "a", "b"]), choose_units(["e", "a", "b", "c", "d", "a"])
    assert (few.name, len(few), few.count()) == ("pair", 3, "3 pairs")
    assert (many.name, len(many)) == ("scene", 5)
    assert many.of_pair[1] == many.of_pair[5]
    assert choose_units(["a", "a"], "scene").count() == "1 scene"
    assert len(choose_units(list("abcdea"), "pair")) == 6
    with pytest.raises(InputError, match="auto, scene, pair"):
        choose_units(["a"], "image")
