"""Cliff's delta against its definition and against the Mann-Whitney statistic."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from sfmkit.errors import InputError
from sfmkit.evaluation.effect_size import cliffs_delta


def test_equals_the_definition_and_the_rank_biserial_correlation():
    rng = np.random.default_rng(0)
    values, first = rng.integers(0, 30, 400), rng.random(400) < 0.3
    a, b = values[first], values[~first]
    e = cliffs_delta(values, first)
    assert e.delta == pytest.approx(np.sign(a[:, None] - b).mean())
    assert e.delta == pytest.approx(2 * mannwhitneyu(a, b).statistic / (len(a) * len(b)) - 1)
    assert e.n == (len(a), len(b))


def test_extremes():
    values = np.arange(10)
    assert cliffs_delta(values, values >= 5).delta == 1
    assert cliffs_delta(values, values < 5).delta == -1
    assert cliffs_delta(np.ones(10), values < 5) == (0, 0, 0, (5, 5))


def test_the_interval_covers():
    """Two normal groups one deviation apart: delta is 2 Phi(1 / sqrt 2) - 1 = 0.5205."""
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(100):
        values, first = rng.normal(size=200), np.arange(200) < 80
        values[first] += 1
        e = cliffs_delta(values, first, draws=200)
        covered += e.low <= 0.5205 <= e.high
    assert 88 <= covered <= 100


def test_values_that_come_in_cells_are_drawn_in_cells():
    """25 copies of everything tell nothing new, so the interval must not shrink."""
    rng = np.random.default_rng(0)
    values, first = rng.normal(size=60), np.arange(60) < 30
    once = cliffs_delta(values, first)
    many = np.repeat(values, 25), np.repeat(first, 25)
    alone, cells = cliffs_delta(*many), cliffs_delta(*many, np.repeat(np.arange(60), 25))
    assert cells[:3] == pytest.approx(once[:3])
    assert alone.high - alone.low < 0.3 * (once.high - once.low)


def test_bad_input():
    with pytest.raises(InputError, match="0 and 3 members"):
        cliffs_delta(np.arange(3), np.zeros(3, dtype=bool))
    with pytest.raises(InputError, match="NaN"):
        cliffs_delta(np.array([1, np.nan]), np.array([True, False]))
