"""What an exercise is: a question, the right answer, and the wrong ones with their explanations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Exercise:
    """One exercise.

    Attributes:
        question: what is asked, in one or two sentences.
        right: computes the answer; of the inputs for a function exercise, of nothing for a value.
        wrong: what people do instead, with what to tell them; same arguments as `right`.
        inputs: argument tuples that an answer is tried on, None where the answer is a value.
        up_to_scale: answers that differ by a factor, sign included, are the same (homogeneous
            quantities).
        tolerance: relative to the largest entry of the right answer.
    """

    question: str
    right: Callable[..., Any]
    wrong: tuple[tuple[Callable[..., Any], str], ...] = ()
    inputs: Callable[[], tuple[tuple[Any, ...], ...]] | None = None
    up_to_scale: bool = False
    tolerance: float = 1e-3
