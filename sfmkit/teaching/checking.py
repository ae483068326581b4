"""``check("04.1", answer)``: tells a student whether an answer is right, and if it is not, what
probably went wrong.

An exercise is a question, the right way to answer it, and the wrong ways that people take, each
with its explanation. Answers are values or functions; a function is tried on the exercise's own
inputs. Nothing is stored that is not computed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from textwrap import fill
from typing import Any

import numpy as np

from ..errors import InputError
from .exercise import Exercise
from .exercises import EXERCISES

ROUNDED = 0.01  # an answer this near, relatively, was meant to be the value
WIDTH = 96  # characters: a cell of a notebook breaks longer lines in the middle of words


@dataclass(frozen=True)
class Judgement:
    """Whether an answer is right, and what to tell whoever gave it."""

    right: bool
    message: str
    answered: bool = True


def check(exercise: str, answer: Any) -> None:
    """Judge the answer to an exercise and print what there is to say about it.

    Args:
        exercise: its name, such as ``"04.1"``.
        answer: a number, an array, a string, or a function where one is asked for; ``...`` (not
            answered yet) prints the question.

    Raises:
        InputError: no such exercise.
    """
    judgement = judge(exercise, answer)
    sign = "✓ " if judgement.right else "✗ " if judgement.answered else "○ "
    print(fill(judgement.message, WIDTH, initial_indent=sign, subsequent_indent="  "))


def judge(exercise: str, answer: Any, exercises: Mapping[str, Exercise] | None = None) -> Judgement:
    """Judge without printing; `exercises` are :data:`sfmkit.teaching.exercises.EXERCISES` unless
    given."""
    exercises = EXERCISES if exercises is None else exercises
    if exercise not in exercises:
        near = get_close_matches(str(exercise), exercises, n=1)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        raise InputError(f"there is no exercise '{exercise}'.{hint} Known: {', '.join(exercises)}")
    task = exercises[exercise]
    if answer is ...:
        return Judgement(False, f"{exercise} is not answered yet. {task.question}", answered=False)
    return _judge_value(task, answer) if task.inputs is None else _judge_function(task, answer)


def _judge_value(task: Exercise, answer: Any) -> Judgement:
    if callable(answer):
        return Judgement(
            False, "A value is asked for here, not a function: call it and give what it returns."
        )
    if _same(answer, task.right(), task):
        return Judgement(True, "Right.")
    rounded = replace(
        task, tolerance=max(task.tolerance, ROUNDED)
    )  # what goes wrong is told of rounded numbers too
    for mistake, why in task.wrong:
        if _same(answer, mistake(), rounded):
            return Judgement(False, why)
    if _same(answer, task.right(), rounded):
        return Judgement(False, "Close, but not close enough: give more digits.")
    return Judgement(False, _difference(answer, task.right(), task))


def _judge_function(task: Exercise, answer: Any) -> Judgement:
    assert task.inputs is not None
    if not callable(answer):
        return Judgement(
            False, "A function is asked for here; give the function itself, without calling it."
        )
    trials = task.inputs()
    answers = []
    for arguments in trials:
        try:
            answers.append(
                answer(*(np.copy(a) if isinstance(a, np.ndarray) else a for a in arguments))
            )
        except (
            Exception
        ) as error:  # a student's function may raise anything, and that is worth an explanation too
            shapes = ", ".join(str(np.shape(a)) for a in arguments)
            return Judgement(
                False,
                f"Your function raised {type(error).__name__}: {error}. Its arguments had the shapes {shapes}.",
            )
    if all(a is None or a is ... for a in answers):
        return Judgement(
            False, f"Your function returns nothing yet. {task.question}", answered=False
        )
    expected = [task.right(*arguments) for arguments in trials]
    wrong = [k for k, (a, e) in enumerate(zip(answers, expected)) if not _same(a, e, task)]
    if not wrong:
        return Judgement(True, f"Right, on all {len(trials)} inputs tried.")
    for mistake, why in task.wrong:
        if all(_same(a, mistake(*arguments), task) for a, arguments in zip(answers, trials)):
            return Judgement(False, why)
    k = wrong[0]
    share = (
        ""
        if len(wrong) == len(trials)
        else f"Right for {len(trials) - len(wrong)} of {len(trials)} inputs. "
    )
    return Judgement(False, share + _difference(answers[k], expected[k], task))


def _array(value: Any) -> np.ndarray | None:
    """The numbers of a value (torch tensors included), None where it has none."""
    try:
        return np.asarray(value.detach() if hasattr(value, "detach") else value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _same(answer: Any, expected: Any, task: Exercise) -> bool:
    if isinstance(expected, str):
        return isinstance(answer, str) and answer.strip().lower() == expected
    a, e = _array(answer), np.asarray(expected, dtype=np.float64)
    if (
        a is None
        or a.size != e.size
        or np.squeeze(a).shape != np.squeeze(e).shape
        or not np.isfinite(a).all()
    ):
        return False
    if task.up_to_scale:
        if not a.any():
            return False
        a, e = a / np.linalg.norm(a), e / np.linalg.norm(e)
        a = a if (a * e).sum() > 0 else -a
    return bool(
        np.abs(np.squeeze(a) - np.squeeze(e)).max(initial=0)
        <= task.tolerance * max(np.abs(e).max(initial=0), 1e-12)
    )


def _difference(answer: Any, expected: Any, task: Exercise) -> str:
    """What there is to say about a wrong answer without giving the right one away."""
    if isinstance(expected, str):
        return f"Not so. {task.question}"
    a, e = _array(answer), np.asarray(expected, dtype=np.float64)
    if answer is None:
        return f"Your answer is None: was it computed? {task.question}"
    if isinstance(answer, str):
        return f"A number is asked for, without words or units. {task.question}"
    if a is None:
        return f"A number or an array is asked for, not {type(answer).__name__}."
    if np.squeeze(a).shape != np.squeeze(e).shape:
        return f"The answer has the shape {e.shape}, yours has {a.shape}."
    if not np.isfinite(a).all():
        return "Your answer holds NaN or infinite values: is something divided by zero?"
    if e.size == 1 and not task.up_to_scale and np.abs(e).max() > 0:
        size = "small" if float(a.ravel()[0]) < float(e.ravel()[0]) else "large"
        return f"Not right: your value is too {size}. {task.question}"
    if not task.up_to_scale and np.allclose(
        -a, e, rtol=0, atol=task.tolerance * max(np.abs(e).max(), 1e-12)
    ):
        return "Only the sign is wrong."
    if (
        np.squeeze(a).ndim == 2
        and a.shape == e.T.shape
        and _same(np.squeeze(a).T, np.squeeze(e), task)
    ):
        return "Your matrix is the transpose of the right one."
    return f"Not right yet. {task.question}"
