"""What is done, before it is done: each thing once."""

from __future__ import annotations

import numpy as np
import pytest
from small_sweep import OPERATORS, pairs

from sfmkit.ablation.cache import Cache
from sfmkit.ablation.plan import make_plan
from sfmkit.datasets import Pair
from sfmkit.errors import InputError, OperatorError

FIVE = ("surf", "orb", "fast-brief", "sift", "akaze")


def test_31_combinations_cost_five_detections_an_image_and_five_matchings_a_pair(tmp_path):
    plan = make_plan(pairs(tmp_path), FIVE, seeds=3)
    counts = plan.count(None)
    assert counts.detections == 5 * 4  # three pairs share their first image
    assert counts.matchings == 5 * 3
    assert counts.estimates == counts.rows == 31 * 3 * 3
    assert len({job.key for unit in plan.units for job in unit.jobs}) == 31 * 3 * 3
    assert [(u.pair, u.variant) for u in plan.units] == sorted(
        [(u.pair, u.variant) for u in plan.units], key=lambda x: x[0]
    )


def test_a_varied_operator_is_searched_again_and_nothing_else_is(tmp_path):
    plan = make_plan(pairs(tmp_path), OPERATORS, vary={"akaze.threshold": [0.001, 0.002]})
    counts = plan.count(None)
    assert counts.detections == 4 * (2 + 2)
    assert counts.matchings == 3 * (2 + 2)
    assert counts.rows == 3 * (
        3 + 2 * 4
    )  # three combinations without AKAZE once, four with it twice


def test_presets_and_stage_settings_share_detections(tmp_path):
    counts = make_plan(pairs(tmp_path), OPERATORS, vary={"merge_radius": [0.5, 1.0, None]}).count(
        None
    )
    assert (counts.detections, counts.matchings, counts.rows) == (12, 9, 3 * 7 * 3)


def test_keys_follow_the_image_and_its_options_and_not_its_path(tmp_path):
    one = make_plan(pairs(tmp_path / "a"), OPERATORS)
    two = make_plan(pairs(tmp_path / "b"), OPERATORS)
    assert one.detections.keys() == two.detections.keys()
    assert one.identity == two.identity
    (tmp_path / "b" / "img1.png").write_bytes((tmp_path / "b" / "img2.png").read_bytes())
    assert make_plan(pairs_without_writing(tmp_path / "b"), OPERATORS).identity != one.identity
    assert (
        make_plan(pairs(tmp_path / "a"), OPERATORS, vary={"budget": [100]})
        .detections.keys()
        .isdisjoint(one.detections)
    )


def pairs_without_writing(folder):
    return [Pair("small", "noise", "1-2", folder / "img1.png", folder / "img2.png", H=np.eye(3))]


def test_an_estimate_does_not_depend_on_the_order_of_the_operators(tmp_path):
    one, two = (
        make_plan(pairs(tmp_path), o, combos=["/".join(o)]) for o in (OPERATORS, OPERATORS[::-1])
    )
    assert [j.key for u in one.units for j in u.jobs] == [j.key for u in two.units for j in u.jobs]


def test_a_dry_run_knows_what_is_cached(tmp_path):
    cache = Cache(tmp_path / "cache")
    plan = make_plan(pairs(tmp_path / "images"), OPERATORS)
    before = plan.count(cache)
    assert dict(before.cached) == {"features": 0, "matches": 0, "estimates": 0}
    key = next(iter(plan.detections))
    cache.put_bytes("features", key, b"whatever")
    after = plan.count(cache)
    assert after.cached["features"] == 1
    assert after.seconds < before.seconds


def test_an_unreadable_image_is_a_pair_that_cannot_be_run_and_not_an_error(tmp_path):
    found = pairs(tmp_path)
    (tmp_path / "img3.png").write_text("no picture")
    (tmp_path / "img4.png").unlink()
    plan = make_plan(found, OPERATORS)
    assert ["text file" in p.failure or "no file" in p.failure for p in plan.pairs] == [
        False,
        True,
        True,
    ]
    assert plan.count(None).matchings == 3


@pytest.mark.parametrize(
    ("data", "operators", "error"),
    [
        ("atlantis", ("orb",), InputError),
        ([], ("orb",), InputError),
        ("", ("orb",), InputError),
        ("planes", ("orbs",), OperatorError),
    ],
)
def test_requests_that_cannot_be(data, operators, error):
    with pytest.raises(error):
        make_plan(data, operators)


@pytest.mark.parametrize("seeds", [0, -1, 1.5, True])
def test_seeds_that_cannot_be(tmp_path, seeds):
    with pytest.raises(InputError, match="seeds"):
        make_plan(pairs(tmp_path), OPERATORS, seeds=seeds)
