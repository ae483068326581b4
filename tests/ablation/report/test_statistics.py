"""The statistics of ablations against closed forms, published examples, enumeration, SciPy and
simulation."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest
from scipy import stats

from sfmkit.ablation.report.contributions import shapley
from sfmkit.ablation.report.differences import differences, holm, least_p, signed_rank
from sfmkit.ablation.report.intervals import mean_interval, median_interval, share_best
from sfmkit.ablation.report.pareto import pareto_front
from sfmkit.ablation.report.ranks import rank
from sfmkit.errors import InputError

PLAYERS = ("a", "b", "c", "d")


def game(value, players=PLAYERS):
    every = (c for n in range(1, len(players) + 1) for c in combinations(players, n))
    return {frozenset(c): value(frozenset(c)) for c in every}


def test_shapley_of_an_additive_game_is_what_each_player_adds():
    worth = {"a": 0.1, "b": -2.0, "c": 3.5, "d": 0.0}
    found = shapley(game(lambda s: np.array(sum(worth[p] for p in s))), PLAYERS)
    np.testing.assert_allclose(found, list(worth.values()), atol=1e-12)


@pytest.mark.parametrize("carrier", [("a",), ("a", "c"), ("b", "c", "d"), PLAYERS])
def test_shapley_of_a_unanimity_game_is_shared_by_its_carrier(carrier):
    found = shapley(game(lambda s: np.array(float(set(carrier) <= s))), PLAYERS)
    np.testing.assert_allclose(found, [(p in carrier) / len(carrier) for p in PLAYERS], atol=1e-12)


def test_shapley_adds_up_to_all_less_nothing_and_is_the_mean_over_orders_of_joining():
    rng = np.random.default_rng(3)
    values = game(lambda s: rng.normal(size=5))
    found = shapley(values, PLAYERS, nothing=0.25)
    np.testing.assert_allclose(found.sum(-1), values[frozenset(PLAYERS)] - 0.25)
    by_orders = np.zeros((5, 4))
    for order in permutations(range(4)):
        before = np.full(5, 0.25)
        for k in range(4):
            after = values[frozenset(PLAYERS[i] for i in order[: k + 1])]
            by_orders[:, order[k]] += (after - before) / 24
            before = after
    np.testing.assert_allclose(found, by_orders, atol=1e-12)


def test_shapley_refuses_where_combinations_are_missing_and_says_which():
    values = game(lambda s: np.array(1.0))
    del values[frozenset({"b", "d"})]
    with pytest.raises(InputError, match=r"1 of 15 .*b/d.*--combos all"):
        shapley(values, PLAYERS)


@pytest.mark.parametrize("n", [5, 9, 25])
def test_the_signed_rank_test_agrees_with_scipy_without_ties(n):
    rng = np.random.default_rng(n)
    for shift in (0, 0.5, 3):
        d = rng.normal(shift, 1, n)
        assert signed_rank(d) == pytest.approx(stats.wilcoxon(d, method="exact").pvalue, rel=1e-9)


def test_the_signed_rank_test_with_ties_and_zeros_is_what_trying_every_sign_gives():
    d = np.array([0.0, 1, 1, -1, 2, 2, 0, 3, -3, 5])
    ranks = stats.rankdata(np.abs(d[d != 0]))
    seen = ranks[d[d != 0] > 0].sum()
    sums = np.array([np.dot(signs, ranks) for signs in product((0, 1), repeat=len(ranks))])
    p = min(1, 2 * min((sums <= seen + 1e-9).mean(), (sums >= seen - 1e-9).mean()))
    assert signed_rank(d) == pytest.approx(p, rel=1e-12)


def test_the_signed_rank_test_at_its_ends():
    assert signed_rank(np.zeros(7)) == 1
    assert signed_rank(np.arange(1.0, 11)) == pytest.approx(2 / 2**10) == least_p(10)
    d = np.random.default_rng(0).normal(0.1, 1, 400)
    assert signed_rank(d) == pytest.approx(
        stats.wilcoxon(d, method="asymptotic", correction=False).pvalue, rel=1e-6
    )


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1, 1]
    assert holm([]) == []


def test_friedman_agrees_with_scipy_with_and_without_ties():
    rng = np.random.default_rng(1)
    for q in (rng.normal(size=(12, 5)), rng.integers(0, 4, (20, 4)).astype(float)):
        expected = stats.friedmanchisquare(*q.T)
        found = rank(q)
        assert (found.statistic, found.p) == pytest.approx(
            (expected.statistic, expected.pvalue), rel=1e-9
        )


def test_nemenyi_of_the_published_example():
    # Demsar, JMLR 2006, table 6 and section 3.2.3: C4.5 with four settings on 14 data sets.
    auc = np.array(
        [
            [0.763, 0.768, 0.771, 0.798],
            [0.599, 0.591, 0.590, 0.569],
            [0.954, 0.971, 0.968, 0.967],
            [0.628, 0.661, 0.654, 0.657],
            [0.882, 0.888, 0.886, 0.898],
            [0.936, 0.931, 0.916, 0.931],
            [0.661, 0.668, 0.609, 0.685],
            [0.583, 0.583, 0.563, 0.625],
            [0.775, 0.838, 0.866, 0.875],
            [1.000, 1.000, 1.000, 1.000],
            [0.940, 0.962, 0.965, 0.962],
            [0.619, 0.666, 0.614, 0.669],
            [0.972, 0.981, 0.9751, 0.975],
            [0.957, 0.978, 0.946, 0.970],
        ]
    )
    found = rank(auc)
    np.testing.assert_allclose(found.average, [3.143, 2.000, 2.893, 1.964], atol=1e-3)
    assert found.critical_difference == pytest.approx(1.25, abs=5e-3)
    assert [int(i) for i in found.order] == [3, 1, 2, 0]
    assert found.groups == ((0, 3),)
    lenient = rank(auc, alpha=0.10)
    assert lenient.critical_difference == pytest.approx(1.12, abs=5e-3)
    assert lenient.groups == ((0, 2), (2, 3))  # the last differs from the first two, as published
    n, k = auc.shape
    plain = 12 * n / (k * (k + 1)) * ((found.average - (k + 1) / 2) ** 2).sum()
    assert plain == pytest.approx(9.28, abs=5e-3)  # as published, without the correction for ties
    assert found.statistic >= plain


def test_a_ranking_where_nothing_differs():
    found = rank(np.ones((6, 3)))
    assert found.p == 1
    assert found.groups == ((0, 2),)
    with pytest.raises(InputError, match="two setups"):
        rank(np.ones((6, 1)))


def test_known_pareto_fronts():
    cost = np.array([1.0, 2, 3, 4, 2, 5, np.nan])
    error = np.array([9.0, 5, 5, 1, 7, 1, 0])
    assert pareto_front(cost, error).tolist() == [True, True, False, True, False, False, False]
    assert pareto_front(np.array([1.0, 1]), np.array([2.0, 2])).all()
    x = np.linspace(0.1, 1, 50)
    inside = np.random.default_rng(0).uniform(1, 2, (2, 200))
    front = pareto_front(np.r_[x, inside[0]], np.r_[0.1 / x, inside[1]])
    assert front[:50].all()
    assert not front[50:].any()


@pytest.mark.parametrize("skewed", [False, True], ids=["normal", "exponential"])
def test_intervals_of_means_cover_the_truth_as_often_as_they_say(skewed):
    rng = np.random.default_rng(7)
    pairs, trials, seeds, truth = 40, 2000, 3, 1.0
    between = (
        rng.exponential(1, (pairs, trials, 1)) if skewed else rng.normal(1, 1, (pairs, trials, 1))
    )
    values = between + rng.normal(0, 0.5, (pairs, trials, seeds))  # seeds scatter around their pair
    _, low, high = mean_interval(values.mean(2), draws=2000)
    assert 0.92 <= ((low <= truth) & (truth <= high)).mean() <= 0.965
    _, low, high = mean_interval(values.transpose(0, 2, 1).reshape(-1, trials), draws=2000)
    assert (
        (low <= truth) & (truth <= high)
    ).mean() < 0.80  # seeds taken for new evidence: not what is done here


def test_intervals_of_medians_cover_the_truth():
    rng = np.random.default_rng(11)
    values = rng.normal(2, 1, (41, 1000, 1)) + rng.normal(0, 0.3, (41, 1000, 3))
    _, low, high = median_interval(values, draws=300)
    assert 0.92 <= ((low <= 2) & (high >= 2)).mean() <= 0.98


def test_intervals_agree_with_scipys_bca():
    x = np.random.default_rng(2).gamma(0.7, 2, (30, 1))
    expected = stats.bootstrap(
        (x[:, 0],), np.mean, method="BCa", n_resamples=20_000, random_state=np.random.default_rng(1)
    ).confidence_interval
    found = mean_interval(x, draws=20_000)
    assert (found.low[0], found.high[0]) == pytest.approx((expected.low, expected.high), rel=0.02)


def test_intervals_of_what_does_not_vary_and_of_one_pair():
    assert mean_interval(np.full((9, 2), 0.3)).low.tolist() == pytest.approx([0.3, 0.3])
    assert np.isnan(mean_interval(np.array([[0.4]])).low).all()
    assert np.isnan(median_interval(np.ones((1, 2, 3))).high).all()


def test_false_differences_are_rare_and_real_ones_are_found():
    rng = np.random.default_rng(5)
    false = 0
    for _ in range(60):
        same = rng.normal(0.5, 0.1, (20, 1)) + rng.normal(0, 0.02, (20, 6))
        false += any(d.real for d in differences(same, [(0, j) for j in range(1, 6)]))
    assert false <= 8  # 5 % of 60 are 3
    shifted = same + np.array([0.1, 0, 0, 0, 0, 0])
    assert all(d.real and d.value > 0 for d in differences(shifted, [(0, j) for j in range(1, 6)]))


def test_the_share_of_samples_in_which_a_setup_is_best():
    q = np.random.default_rng(0).normal(0, 1, (30, 1)) + np.array([[0.0, 1.0, 1.0]])
    np.testing.assert_allclose(share_best(q), [0, 0.5, 0.5])
