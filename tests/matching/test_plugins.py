"""The choice of matchers: names of operators, and the key for all others."""

from __future__ import annotations

import pytest

from sfmkit.errors import OperatorError
from sfmkit.mapping.planning import make_recipe
from sfmkit.matching import canonical_matchers, choose_matchers, matcher_of
from sfmkit.options import MatchOptions


def test_the_names_of_operators_become_canonical_and_the_key_for_others_stays():
    chosen = canonical_matchers({"SURF": "nearest", "*": "lightglue"})
    assert chosen == {"surf": "nearest", "*": "lightglue"}
    options = choose_matchers(MatchOptions(), chosen)
    assert [matcher_of(name, options) for name in ("surf", "aliked")] == ["nearest", "lightglue"]


@pytest.mark.parametrize("matchers", [None, "lightglue"])
def test_a_choice_for_all_operators_stays(matchers):
    assert canonical_matchers(matchers) == matchers


def test_an_unknown_operator_is_rejected():
    with pytest.raises(OperatorError, match="nonsense"):
        canonical_matchers({"nonsense": "nearest"})


def test_the_recipe_of_a_folder_takes_a_matcher_for_all_other_operators():
    recipe = make_recipe(("Surf", "aliked"), matchers={"SURF": "nearest", "*": "lightglue"})
    match = recipe.options.match
    assert [matcher_of(name, match) for name in recipe.operators] == ["nearest", "lightglue"]
