"""The contribution of each operator: the loss without it, and its Shapley value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from ...errors import InputError
from .intervals import Interval, mean_interval
from .scores import Scores, Setup

NOTHING = 0.0  # the quality of the empty set, which gives no answer

Game = Mapping[frozenset[str], np.ndarray]


@dataclass(frozen=True, eq=False)
class Contributions:
    """The contributions of the operators of a data set, as AUC.

    Attributes:
        variant: preset and changed settings.
        operators: n names.
        alone: quality of each single operator.
        without: loss of quality when one operator is removed from all.
        shapley: values, which add up to the quality of all; None if combinations are missing.
        missing: the number of missing combinations, and an example.
    """

    variant: str
    operators: tuple[str, ...]
    alone: Interval | None
    without: Interval | None
    shapley: Interval | None
    missing: str = ""


def shapley(game: Game, players: Sequence[str], nothing: float = NOTHING) -> np.ndarray:
    """Compute exact Shapley values.

    ``phi_i = sum over S without i of |S|! (n - |S| - 1)! / n! (v(S + i) - v(S))``.

    Args:
        game: value (...) of every non-empty set of players: numbers or arrays of one shape.
        nothing: value of the empty set.

    Returns:
        (..., n).

    Source: Shapley 1953; the values add up to ``v(all) - nothing``.

    Raises:
        InputError: combinations are missing; the message lists an example.
    """
    missing = missing_combinations(game, players)
    if missing:
        raise InputError(f"Shapley values need every combination; {_say_missing(missing, players)}")
    n = len(players)
    some = np.asarray(game[frozenset(players)], dtype=np.float64)

    def value(members: frozenset[str]) -> np.ndarray:
        return (
            np.asarray(game[members], dtype=np.float64) if members else np.full_like(some, nothing)
        )

    shares = []
    for i in players:
        others = [p for p in players if p != i]
        share = np.zeros_like(some)
        for size in range(n):
            weight = factorial(size) * factorial(n - size - 1) / factorial(n)
            for subset in map(frozenset, combinations(others, size)):
                share = share + weight * (value(subset | {i}) - value(subset))
        shares.append(share)
    return np.stack(shares, axis=-1)


def missing_combinations(game: Game, players: Sequence[str]) -> list[tuple[str, ...]]:
    every = (c for size in range(1, len(players) + 1) for c in combinations(players, size))
    return [c for c in every if frozenset(c) not in game]


def _say_missing(missing: Sequence[tuple[str, ...]], players: Sequence[str]) -> str:
    return (
        f"{len(missing)} of {2 ** len(players) - 1} are not in this sweep, e.g. "
        f"{'/'.join(missing[0])}: run it with "
        "--combos all"
    )


def contributions(scores: Scores) -> list[Contributions]:
    """Compute what every operator contributes.

    This is done for each preset and choice of changed settings with which the sweep ran all
    operators together.

    A loss without an operator is paired: it is computed pair by pair, like the Shapley values, on
    the same bootstrap samples of scenes or pairs.
    """
    everything = max(len(s.operators) for s in scores.setups)
    largest = [s for s in scores.setups if len(s.operators) == everything]
    if len({s.operators for s in largest}) > 1 or everything < 2:
        return []
    return [_contributions(scores, s) for s in largest]


def _contributions(scores: Scores, full: Setup) -> Contributions:
    game: dict[frozenset[str], np.ndarray] = {}
    for c, setup in enumerate(scores.setups):
        if setup == full.only(setup.operators):
            game[frozenset(setup.operators)] = scores.quality[:, c]
    players, all_of_them = full.operators, frozenset(full.operators)
    of_pair = scores.units.of_pair
    singles = [game.get(frozenset({o})) for o in players]
    left_out = [game.get(all_of_them - {o}) for o in players]
    missing = missing_combinations(game, players)
    return Contributions(
        full.changes,
        players,
        None
        if any(v is None for v in singles)
        else mean_interval(np.stack(singles, axis=1), of_pair),  # type: ignore[arg-type]
        None
        if any(v is None for v in left_out)
        else mean_interval(np.stack([game[all_of_them] - v for v in left_out], axis=1), of_pair),  # type: ignore[operator]
        None if missing else mean_interval(shapley(game, players), of_pair),
        _say_missing(missing, players) if missing else "",
    )
