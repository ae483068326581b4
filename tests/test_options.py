"""Presets with the changes that commands and benchmarks offer."""

from __future__ import annotations

import pytest
from small_sweep import pairs

from sfmkit.ablation.plan import make_plan
from sfmkit.errors import InputError
from sfmkit.options import DEFAULT, PAPER, PRESETS, adjust_preset


def test_a_preset_without_changes_is_the_preset():
    for name, options in PRESETS.items():
        assert adjust_preset(name) == options


def test_changes_enter_their_stages_only():
    changed = adjust_preset("dense", threshold_px=2.5, budget=1000, max_size=640)
    assert changed.estimate.threshold_px == 2.5
    assert (changed.detect.budget, changed.detect.max_size) == (1000, 640)
    assert changed.match == PRESETS["dense"].match
    assert changed.detect.preset == "dense"


def test_a_method_belongs_to_its_estimator():
    assert PAPER.estimate.method == "ransac"
    assert adjust_preset("paper", backend="opencv") == PAPER
    assert adjust_preset("paper", backend="torch").estimate.method is None
    assert adjust_preset("default", backend="opencv").estimate.method is DEFAULT.estimate.method


def test_a_sweep_can_change_the_estimator_of_the_papers_preset(tmp_path):
    plan = make_plan(pairs(tmp_path), ("orb",), presets=("paper",), backend="torch")
    assert {unit.variant.options.estimate.method for unit in plan.units if not unit.homography} == {
        None
    }


@pytest.mark.parametrize("change", [{"threshold_px": 0.0}, {"threshold_px": -1.0}])
def test_values_out_of_range_are_refused(change):
    with pytest.raises(InputError, match="threshold_px"):
        adjust_preset("default", **change)


def test_an_unknown_preset_is_refused():
    with pytest.raises(InputError, match="unknown preset 'best'"):
        adjust_preset("best")
