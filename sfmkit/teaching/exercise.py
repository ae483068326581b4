"""The type of an exercise: a question, the correct answer, and common wrong answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Exercise:
    """One exercise.

    Attributes:
        question: One or two sentences; starts with the signature if a function is expected.
        right: Function that computes the correct answer, from the inputs if a function is expected.
        wrong: Common mistakes with their explanations; they have the same arguments as `right`.
        inputs: Function that returns the argument tuples on which a function is tested; None if a
            value is expected.
        up_to_scale: Whether answers that differ by a non-zero factor are equal (homogeneous
            quantities).
        period: Period of the answer (angles): answers that differ by a multiple of it are equal;
            None without a period.
        tolerance: Tolerance relative to the largest entry of the correct answer.
    """

    question: str
    right: Callable[..., Any]
    wrong: tuple[tuple[Callable[..., Any], str], ...] = ()
    inputs: Callable[[], tuple[tuple[Any, ...], ...]] | None = None
    up_to_scale: bool = False
    period: float | None = None
    tolerance: float = 1e-3
