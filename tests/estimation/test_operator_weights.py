"""Learned weights against operators whose noise is known."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import InputError
from sfmkit.estimation.operator_weights import (
    OperatorWeights,
    PosedPair,
    PoseError,
    learn_operator_weights,
    match_weights,
)
from sfmkit.geometry.pose import rotation_error, translation_error
from sfmkit.geometry.refinement import refine_essential
from sfmkit.types import Correspondences

D = torch.float64


def pair(seed: int, sigmas: tuple[float, ...] = (0.3, 2.0), n: int = 120) -> PosedPair:
    """Matches of two operators, one much noisier than the other."""
    s = make_scene(n, seed=seed)
    g = torch.Generator().manual_seed(1000 + seed)
    operator = torch.arange(n) % len(sigmas)
    sigma = torch.tensor(sigmas, dtype=D)[operator, None]
    x1, x2 = (x + sigma * torch.randn(n, 2, generator=g, dtype=D) for x in (s.x1, s.x2))
    zeros, rows = torch.zeros(n, dtype=D), torch.arange(n)
    names = ("sharp", "blunt")[: len(sigmas)]
    matches = Correspondences(x1, x2, zeros, zeros, operator, 1 << operator, rows, rows, names, {})
    return PosedPair(matches, s.K1, s.K2, s.R, s.t)


def test_the_sharper_operator_gains_weight():
    pairs = [pair(seed) for seed in range(4)]
    learned = learn_operator_weights(pairs, steps=8, learning_rate=0.3, loss="squared", folds=2)
    assert float(learned.weights[0]) > 2 * float(learned.weights[1])
    assert float(learned.weights.log().sum()) == pytest.approx(0, abs=1e-12)
    assert float(learned.history[-1]) < 0.7 * float(learned.history[0])
    assert len(learned.history) == 9
    torch.testing.assert_close(learned.of(pairs[0].matches)[:2], learned.weights)


def test_weights_of_a_noisier_operator_help_on_held_out_pairs():
    pairs = [pair(seed) for seed in range(4)]
    options = {"steps": 5, "learning_rate": 0.3, "loss": "squared"}
    learned = learn_operator_weights(pairs, folds=2, **options)
    assert learned.training.equal == pytest.approx(float(learned.history[0]))
    assert learned.training.weighted == pytest.approx(float(learned.history[-1]))
    assert learned.held_out.equal == pytest.approx(learned.training.equal)
    assert learned.held_out.weighted < 0.9 * learned.held_out.equal
    assert learned.helps
    # The same by hand: learn from one half, measure the other.
    halves = [pairs[:2], pairs[2:]]
    by_hand = []
    for own, other in (halves, halves[::-1]):
        weights = learn_operator_weights(other, **options)
        for p in own:
            m = p.matches
            R, t = refine_essential(
                p.R, p.t, m.x1, m.x2, p.K1, p.K2, weights.of(m), loss="squared", loss_scale=0.5
            ).pose
            by_hand.append(float(rotation_error(R, p.R) ** 2 + translation_error(t, p.t) ** 2))
    assert learned.held_out.weighted == pytest.approx(sum(by_hand) / 4, rel=1e-6)


def test_weights_that_fit_only_their_own_pair_do_not_help():
    # The noisier operator is the first in one pair and the second in the other.
    pairs = [pair(0, sigmas=(0.2, 3.0)), pair(1, sigmas=(3.0, 0.2))]
    learned = learn_operator_weights(pairs, steps=8, learning_rate=0.3, loss="squared")
    assert learned.held_out.weighted > learned.held_out.equal
    assert not learned.helps


def test_a_single_pair_has_no_held_out_error():
    learned = learn_operator_weights([pair(0)], steps=2)
    assert learned.held_out is None
    assert not learned.helps


def test_a_match_of_several_operators_has_their_mean_weight():
    log_weights = torch.tensor([0.0, 1.0, 3.0], dtype=D)
    weights = match_weights(log_weights, torch.tensor([0b001, 0b010, 0b110]))
    torch.testing.assert_close(weights.log(), torch.tensor([0.0, 1.0, 2.0], dtype=D))


def test_bad_input_is_named():
    with pytest.raises(InputError, match="at least one pair"):
        learn_operator_weights([])
    with pytest.raises(InputError, match="same operators"):
        learn_operator_weights([pair(0), pair(1, sigmas=(1.0,))])
    with pytest.raises(InputError, match="folds"):
        learn_operator_weights([pair(0), pair(1)], folds=3)
    error = PoseError(1.0, 1.0)
    one = torch.ones(1, dtype=D)
    weights = OperatorWeights(("other",), one, torch.zeros(1), error, None, 0, 1)
    with pytest.raises(InputError, match="other"):
        weights.of(pair(0).matches)
