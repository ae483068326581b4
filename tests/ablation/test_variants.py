"""Combinations, presets and varied settings."""

from __future__ import annotations

from itertools import combinations

import pytest

from sfmkit.ablation.variants import Variant, choose_combinations, choose_variants, parse_vary
from sfmkit.errors import InputError, OperatorError
from sfmkit.features import OPERATOR_PLUGINS
from sfmkit.matching.plugins import matcher_of
from sfmkit.options import PAPER

FIVE = ("surf", "orb", "fast-brief", "sift", "akaze")


def test_all_combinations_of_five_are_the_31_subsets_each_once():
    found = choose_combinations(FIVE, "all")
    assert len(found) == 31
    assert {frozenset(c) for c in found} == {
        frozenset(c) for n in range(1, 6) for c in combinations(FIVE, n)
    }
    assert [len(c) for c in found] == sorted(len(c) for c in found)
    assert all(list(c) == sorted(c, key=FIVE.index) for c in found)


def test_pairs_and_leave_one_out():
    assert len(choose_combinations(FIVE, "pairs")) == 5 + 10
    left = choose_combinations(FIVE, "leave-one-out")
    assert sorted(len(c) for c in left) == [1] * 5 + [4] * 5 + [5]


def test_with_two_operators_leave_one_out_names_nothing_twice():
    assert choose_combinations(("surf", "orb"), "leave-one-out") == [
        ("surf",),
        ("orb",),
        ("surf", "orb"),
    ]


def test_a_list_is_put_in_the_operators_order_and_duplicates_go():
    assert choose_combinations(FIVE, "sift/surf,orb,surf/sift") == [("orb",), ("surf", "sift")]
    assert choose_combinations(("fast+freak", "orb"), "fast+freak/orb") == [("fast+freak", "orb")]


@pytest.mark.parametrize("combos", ["surf/harris", "", "everything", "surf/kaze"])
def test_lists_that_cannot_be(combos):
    with pytest.raises((InputError, OperatorError)):
        choose_combinations(FIVE, combos)


def test_a_varied_option_concerns_only_combinations_with_its_operator():
    variants = choose_variants(["default"], parse_vary(["hessian=30,100"]), FIVE)
    assert [dict(v.changes) for v in variants] == [
        {"surf.hessian_threshold": 30.0},
        {"surf.hessian_threshold": 100.0},
    ]
    assert {v.of(("orb", "sift"), True) for v in variants} == {Variant("default")}
    assert variants[1].setting("surf").options == (("hessian_threshold", 100.0),)
    assert variants[1].setting("orb").options == ()


def test_a_default_value_is_not_a_variant():
    known = OPERATOR_PLUGINS.options("surf")["hessian_threshold"]
    vary = {"budget": [40_000, 8000], "surf.hessian_threshold": [known], "matcher": ["nearest"]}
    variants = choose_variants(["default"], vary, FIVE)
    assert {v.of(("surf",), False) for v in variants} == {
        Variant("default"),
        Variant("default", (("budget", 8000),)),
    }
    (paper,) = choose_variants(["paper"], {"surf.hessian_threshold": [known]}, FIVE)
    assert paper.of(("surf",), False).changes  # the preset has another value


def test_settings_of_the_other_kind_of_estimate_are_not_a_variant():
    vary = {"backend": ["opencv"], "confidence": [0.9], "threshold_px": [1.0, 3.0]}
    one, three = choose_variants(["default"], vary, FIVE)
    assert one.of(("orb",), True) == Variant("default", (("threshold_px", 1.0),))
    assert three.of(("orb",), True) == Variant("default")  # 3 px is the default of homographies
    assert dict(one.of(("orb",), False).changes) == {"backend": "opencv", "confidence": 0.9}
    assert one.planar.threshold_px == 1.0
    assert Variant("default").planar.threshold_px == 3.0


def test_a_matcher_per_operator():
    vary = {"orb.matcher": ["mine:match"], "matcher": ["other:match"]}
    (variant,) = choose_variants(["default"], vary, FIVE)
    options = variant.options.match
    assert (matcher_of("orb", options), matcher_of("sift", options)) == (
        "mine:match",
        "other:match",
    )
    assert variant.setting("orb").options == ()
    assert dict(variant.of(("sift",), True).changes) == {"matcher": "other:match"}


def test_stage_settings_reach_their_stage_with_their_type():
    (v,) = choose_variants(
        ["PAPER"], {"budget": ["8000"], "merge_radius": ["none"], "mutual": ["false"]}, FIVE
    )
    assert v.options.detect.budget == 8000
    assert isinstance(v.options.detect.budget, int)
    assert v.options.fuse.merge_radius is None
    assert v.options.match.mutual is False
    assert v.options.estimate == PAPER.estimate
    assert v.setting("orb").preset == "paper"


def test_every_combination_of_varied_values():
    assert (
        len(
            choose_variants(
                ["default", "paper"], {"budget": [1000, 2000], "max_ratio": [0.8, 0.9, None]}, FIVE
            )
        )
        == 12
    )


@pytest.mark.parametrize(
    "vary",
    [
        {"hesian": [3]},
        {"n": [3]},
        {"budget": []},
        {"budget": ["many"]},
        {"budget": ["1.5"]},
        {"mutual": ["maybe"]},
    ],
)
def test_variations_that_cannot_be(vary):
    with pytest.raises(InputError):
        choose_variants(["default"], vary, FIVE)


def test_unknown_presets_and_unreadable_variations():
    with pytest.raises(InputError, match="unknown preset"):
        choose_variants(["best"], None, FIVE)
    with pytest.raises(InputError, match="NAME=VALUE"):
        parse_vary(["budget"])
