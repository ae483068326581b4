"""Rivals, operators and halves of the image that contradict a motion, on known scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from made_up_scene import Scene, make_scene
from scipy.stats import binom, mannwhitneyu

from sfmkit.estimation import estimate_two_view
from sfmkit.estimation.chance import log10_tail
from sfmkit.estimation.halves import Halves, cross_validate
from sfmkit.estimation.rivals import quality_odds
from sfmkit.estimation.witnesses import operator_witnesses, unsupported
from sfmkit.geometry.lie import so3_exp
from sfmkit.geometry.pose import rotation_error
from sfmkit.types import Camera, Correspondences, OperatorCounts, Verdict

SIZE = (640, 480)


def cameras(scene: Scene) -> tuple[Camera, Camera]:
    return Camera(scene.K1.numpy(), SIZE), Camera(scene.K2.numpy(), SIZE)


def matches(x1, x2, ratio, operator_id=None, operators=("made-up",)) -> Correspondences:
    n = len(x1)
    index = torch.arange(n)
    operator_id = torch.zeros(n, dtype=torch.int64) if operator_id is None else operator_id
    counts = {name: OperatorCounts((n, n), n) for name in operators}
    distance = torch.zeros(n, dtype=torch.float64)
    mask = torch.ones_like(operator_id) << operator_id
    return Correspondences(
        x1, x2, distance, ratio, operator_id, mask, index, index, operators, counts
    )


def two_motions(second_ratio: float) -> tuple[Correspondences, Scene, torch.Tensor]:
    """300 matches of one motion, and 200 of another with these distance ratios."""
    scene = make_scene(300, noise=0.2)
    other = so3_exp(torch.tensor([0.1, 0.1, 0.05], dtype=torch.float64))
    g = torch.Generator().manual_seed(1)
    X = torch.rand(200, 3, generator=g, dtype=torch.float64) * torch.tensor([4.0, 3.0, 4.0])
    X = X + torch.tensor([-2.0, -1.5, 4.0])
    y1, y2 = X @ scene.K1.mT, (X @ other.mT + scene.t) @ scene.K2.mT
    x1 = torch.cat((scene.x1, y1[:, :2] / y1[:, 2:]))
    x2 = torch.cat((scene.x2, y2[:, :2] / y2[:, 2:]))
    spread = 0.1 * torch.rand(500, generator=g, dtype=torch.float64)
    ratio = torch.cat((torch.full((300,), 0.6), torch.full((200,), second_ratio))) + spread
    return matches(x1, x2, ratio), scene, other


def test_a_second_motion_of_equal_quality_is_a_rival():
    corr, scene, other = two_motions(0.6)
    view = estimate_two_view(corr, *cameras(scene))
    assert view.verdict is Verdict.AMBIGUOUS
    assert float(rotation_error(view.R, scene.R)) < 0.5
    R, _ = view.alternatives[-1]
    assert float(rotation_error(R, other)) < 0.5
    assert view.evidence["rival_share"] == pytest.approx(200 / 300, abs=0.1)
    assert "another one" in view.reason


def test_a_second_motion_of_worse_matches_is_not_a_rival():
    corr, scene, _ = two_motions(0.9)
    view = estimate_two_view(corr, *cameras(scene))
    assert view.verdict is Verdict.GENERAL
    assert view.evidence["quality_odds"] == math.inf


def test_operators_that_contradict_each_other_are_refused():
    scene = make_scene(300, noise=0.2)
    shuffled = scene.x2.clone()
    shuffled[100:] = shuffled[100:].roll(37, 0)
    operator_id = (torch.arange(300) >= 100).long()
    found = operator_witnesses(
        scene.R,
        scene.t,
        torch.arange(300) < 100,
        scene.x1,
        shuffled,
        scene.K1,
        scene.K2,
        operator_id,
        ("right", "wrong"),
        1.0,
    )
    assert unsupported(found)
    agreeing = operator_witnesses(
        scene.R,
        scene.t,
        torch.ones(300, dtype=torch.bool),
        scene.x1,
        scene.x2,
        scene.K1,
        scene.K2,
        operator_id,
        ("right", "right too"),
        1.0,
    )
    assert not unsupported(agreeing)
    assert all(w.inliers == w.matches for w in agreeing.values())


def halves_of(scene: Scene) -> Halves:
    """The halves of a scene without distance ratios, of one operator."""
    n = len(scene.x1)
    ratio = torch.full((n,), torch.nan, dtype=torch.float64)
    operator_id = torch.zeros(n, dtype=torch.int64)
    motion = scene.R, scene.t, scene.x1, scene.x2, scene.K1, scene.K2
    return cross_validate(*motion, SIZE, ratio, operator_id, 1.0)


@pytest.mark.parametrize("wrong", [0.0, 0.6])
def test_halves_of_a_scene_find_one_motion(wrong):
    scene = make_scene(400, noise=0.3, outliers=wrong)
    found = halves_of(scene)
    assert found.consistent
    assert max(found.apart_deg) < 5


def test_halves_of_random_matches_do_not():
    scene = make_scene(400, outliers=1.0)
    found = halves_of(scene)
    assert not found.consistent


@pytest.mark.parametrize("k, n, p", [(3, 10, 0.2), (40, 100, 0.1), (0, 5, 0.5)])
def test_the_tail_is_that_of_the_binomial_distribution(k, n, p):
    expected = math.log10(sum(binom.pmf(i, n, p) for i in range(k, n + 1)))
    assert log10_tail(k, n, p) == pytest.approx(expected, abs=1e-9)


def test_a_tail_too_small_for_floating_point_is_bounded():
    assert -20_000 < log10_tail(5_000, 5_000, 1e-3) < -14_000


def test_odds_agree_with_mann_and_whitney():
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 20, 60) / 20, rng.integers(5, 25, 80) / 20
    u = mannwhitneyu(b, a).statistic / (60 * 80)
    found = quality_odds(torch.tensor(np.r_[a, np.nan]), torch.tensor(b))
    assert found == pytest.approx(u / (1 - u))
    assert math.isnan(quality_odds(torch.tensor([np.nan]), torch.tensor(b)))
