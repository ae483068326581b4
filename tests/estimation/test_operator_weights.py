"""Learned weights against operators whose noise is known."""

from __future__ import annotations

import pytest
import torch
from made_up_scene import make_scene

from sfmkit.errors import InputError
from sfmkit.estimation.operator_weights import (
    OperatorWeights,
    PosedPair,
    learn_operator_weights,
    match_weights,
)
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
    learned = learn_operator_weights(pairs, steps=8, learning_rate=0.3, loss="squared")
    assert float(learned.weights[0]) > 2 * float(learned.weights[1])
    assert float(learned.weights.log().sum()) == pytest.approx(0, abs=1e-12)
    assert float(learned.history[-1]) < 0.7 * float(learned.history[0])
    assert len(learned.history) == 9
    torch.testing.assert_close(learned.of(pairs[0].matches)[:2], learned.weights)


def test_a_match_of_several_operators_has_their_mean_weight():
    log_weights = torch.tensor([0.0, 1.0, 3.0], dtype=D)
    weights = match_weights(log_weights, torch.tensor([0b001, 0b010, 0b110]))
    torch.testing.assert_close(weights.log(), torch.tensor([0.0, 1.0, 2.0], dtype=D))


def test_bad_input_is_named():
    with pytest.raises(InputError, match="at least one pair"):
        learn_operator_weights([])
    with pytest.raises(InputError, match="same operators"):
        learn_operator_weights([pair(0), pair(1, sigmas=(1.0,))])
    weights = OperatorWeights(("other",), torch.ones(1, dtype=D), torch.zeros(1))
    with pytest.raises(InputError, match="other"):
        weights.of(pair(0).matches)
