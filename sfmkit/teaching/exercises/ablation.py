"""Notebook 08: ablations."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exercise import Exercise
from ._inputs import random_inputs


def _auc(errors: np.ndarray, threshold: float) -> float:
    return float(np.clip(1 - errors / threshold, 0, None).mean())


def _auc_inputs() -> tuple[tuple[Any, ...], ...]:
    g = np.random.default_rng(0)
    some = g.gamma(1.0, 2.0, 12)
    return (
        (some, 5.0),
        (np.append(some, [np.inf, np.inf, np.inf]), 5.0),
        (np.append(some, np.inf), 3.0),
    )


def _paired(g: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    hard = g.normal(0.5, 0.3, 25)
    return hard + g.normal(0.05, 0.05, 25), hard


EXERCISES: dict[str, Exercise] = {
    "08.1": Exercise(
        "auc(errors, threshold): the area under the curve of the share of runs with an error of at "
        "most e, for e from 0 to the threshold, divided by the threshold. A run without a result "
        "has an infinite error.",
        _auc,
        (
            (
                lambda errors, t: _auc(errors[np.isfinite(errors)], t),
                "You omit the runs without a result. A method could then improve its score by "
                "rejecting "
                "difficult pairs.",
            ),
            (
                lambda errors, t: (errors <= t).mean(),
                "This is the value of the curve at the threshold, not the area under it.",
            ),
            (
                lambda errors, t: np.clip(t - errors, 0, None).mean(),
                "This area grows with the threshold. Divide by the threshold, so that an error of "
                "zero "
                "gives 1.",
            ),
        ),
        _auc_inputs,
    ),
    "08.2": Exercise(
        "standard_error(a, b): the standard error of the mean difference of two combinations, "
        "whose "
        "scores a and b belong to the same pairs in the same order (use ddof=1).",
        lambda a, b: np.std(a - b, ddof=1) / np.sqrt(len(a)),
        (
            (
                lambda a, b: np.sqrt((np.var(a, ddof=1) + np.var(b, ddof=1)) / len(a)),
                "This formula is for two independent groups of pairs. Both combinations ran on "
                "the same "
                "pairs: the difficulty of a pair affects both scores and cancels in a - b.",
            ),
            (
                lambda a, b: np.std(a - b, ddof=1),
                "This is the standard deviation of a single pair. That of the mean of n pairs is "
                "smaller "
                "by the square root of n.",
            ),
            (
                lambda a, b: np.std(a - b) / np.sqrt(len(a)),
                "Almost: the mean was estimated from the same differences, so divide by n - 1 "
                "(ddof=1).",
            ),
        ),
        random_inputs(_paired),
        tolerance=1e-6,
    ),
    "08.3": Exercise(
        "shapley(v1, v2, v12): the Shapley values of two operators with the scores v1 and v2 alone "
        "and v12 together; the empty set has the score 0.",
        lambda v1, v2, v12: np.array([v1 + v12 - v2, v2 + v12 - v1]) / 2,
        (
            (
                lambda v1, v2, v12: np.array([v12 - v2, v12 - v1]),
                "This is the loss without each operator: its gain if it is added last. Average it "
                "with "
                "the gain if it is added first.",
            ),
            (
                lambda v1, v2, v12: np.array([v1, v2]),
                "This is the score of each operator alone: its gain if it is added first. Average "
                "it "
                "with the gain if it is added last.",
            ),
            (
                lambda v1, v2, v12: v12 * np.array([v1, v2]) / (v1 + v2),
                "The sum is correct, but the parts are not the gains averaged over both orders.",
            ),
        ),
        lambda: ((0.6, 0.5, 0.8), (0.4, 0.4, 0.8), (0.7, 0.2, 0.7)),
    ),
    "08.4": Exercise(
        "All 31 combinations of five operators are compared with one another and are in fact "
        "equally "
        "good. How many of the uncorrected p-values are below 0.05 on average?",
        lambda: 31 * 30 / 2 * 0.05,
        (
            (
                lambda: 31 * 0.05,
                "There are more comparisons than combinations: each combination with every other "
                "one.",
            ),
            (lambda: 31 * 30 * 0.05, "A with B and B with A are the same comparison."),
            (
                lambda: 0,
                "By chance, one p-value in twenty is below 0.05, and there are many comparisons.",
            ),
        ),
    ),
}
