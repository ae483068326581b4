"""Grading of the answers to the exercises: ``check("04.1", answer)``.

An exercise has a question, the correct answer and common mistakes with their explanations. Answers
are values or functions; a function is tested on the inputs of the exercise. The correct answers are
computed, not stored.
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
from .hints import HINTS
from .marks import append_mark, current_class

ROUNDED = 0.01  # relative difference up to which a value is regarded as rounded too much
WIDTH = 96  # characters that fit into one line of a notebook cell


@dataclass(frozen=True)
class Judgement:
    """The result of grading an answer, with the message to print."""

    right: bool
    message: str
    answered: bool = True


def check(exercise: str, answer: Any = ..., hint: int = 0) -> None:
    """Grade the answer to an exercise and print the result.

    In a class (`sfmkit lab --class`), the check is also written to the marks file.

    Args:
        exercise: Number of the exercise, for example ``"04.1"``.
        answer: A number, array, string or function, depending on the exercise; ``...`` prints
            the question.
        hint: Level up to which hints are printed if the answer is not correct: 1 for the idea, 2
            for the formula too.

    Raises:
        InputError: There is no such exercise or level.
    """
    judgement = judge(exercise, answer)
    if hint not in range(len(HINTS[exercise]) + 1):
        raise InputError(f"hint is 0, 1 or 2, not {hint!r}")
    sign = "✓ " if judgement.right else "✗ " if judgement.answered else "○ "
    print(fill(judgement.message, WIDTH, initial_indent=sign, subsequent_indent="  "))
    shown = 0 if judgement.right else int(hint)
    for level, words in enumerate(HINTS[exercise][:shown], start=1):
        start = f"  hint {level}: "
        print(fill(words, WIDTH, initial_indent=start, subsequent_indent=" " * len(start)))
    _log(exercise, judgement, shown)


def _log(exercise: str, judgement: Judgement, hint: int) -> None:
    """Write the check to the marks file of the class, if there is a class."""
    if (entry := current_class()) is None or not (judgement.answered or hint):
        return
    student, file = entry
    try:
        append_mark(file, student, exercise, judgement.right, judgement.answered, hint)
    except OSError as error:
        print(f"The check was not recorded: {file} cannot be written ({error}).")


def judge(exercise: str, answer: Any, exercises: Mapping[str, Exercise] | None = None) -> Judgement:
    """Grade an answer without printing.

    `exercises` defaults to :data:`sfmkit.teaching.exercises.EXERCISES`.
    """
    exercises = EXERCISES if exercises is None else exercises
    if exercise not in exercises:
        near = get_close_matches(str(exercise), exercises, n=1)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        raise InputError(f"there is no exercise '{exercise}'.{hint} Known: {', '.join(exercises)}")
    task = exercises[exercise]
    if answer is ...:
        return Judgement(
            False, f"{exercise} has not been answered. {task.question}", answered=False
        )
    return _judge_value(task, answer) if task.inputs is None else _judge_function(task, answer)


def _judge_value(task: Exercise, answer: Any) -> Judgement:
    if callable(answer):
        return Judgement(
            False,
            "This exercise expects a value, not a function. Call your function and pass its "
            "result.",
        )
    if _same(answer, task.right(), task):
        return Judgement(True, "Correct.")
    # Mistakes are recognised in rounded numbers as well.
    rounded = replace(task, tolerance=max(task.tolerance, ROUNDED))
    for mistake, why in task.wrong:
        if _same(answer, mistake(), rounded):
            return Judgement(False, why)
    if _same(answer, task.right(), rounded):
        return Judgement(False, "Close, but not precise enough. Give more digits.")
    return Judgement(False, _difference(answer, task.right(), task))


def _judge_function(task: Exercise, answer: Any) -> Judgement:
    assert task.inputs is not None
    if not callable(answer):
        return Judgement(
            False, "This exercise expects a function. Pass the function itself without calling it."
        )
    trials = task.inputs()
    answers = []
    for arguments in trials:
        try:
            answers.append(
                answer(*(np.copy(a) if isinstance(a, np.ndarray) else a for a in arguments))
            )
        except Exception as error:  # a student's function can raise any exception
            shapes = ", ".join(str(np.shape(a)) for a in arguments)
            return Judgement(
                False,
                f"Your function raised {type(error).__name__}: {error}. "
                f"The shapes of its arguments were {shapes}.",
            )
    if all(a is None or a is ... for a in answers):
        return Judgement(
            False, f"Your function does not return an answer yet. {task.question}", answered=False
        )
    expected = [task.right(*arguments) for arguments in trials]
    wrong = [k for k, (a, e) in enumerate(zip(answers, expected)) if not _same(a, e, task)]
    if not wrong:
        return Judgement(True, f"Correct on all {len(trials)} inputs.")
    for mistake, why in task.wrong:
        if all(_same(a, mistake(*arguments), task) for a, arguments in zip(answers, trials)):
            return Judgement(False, why)
    k = wrong[0]
    share = (
        ""
        if len(wrong) == len(trials)
        else f"Correct for {len(trials) - len(wrong)} of {len(trials)} inputs. "
    )
    return Judgement(False, share + _difference(answers[k], expected[k], task))


def _array(value: Any) -> np.ndarray | None:
    """Convert a value (also a torch tensor) to an array; None if that is not possible."""
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
    if task.period is not None:
        a = e + (a.reshape(e.shape) - e + task.period / 2) % task.period - task.period / 2
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
    """Describe a wrong answer without revealing the correct one."""
    if isinstance(expected, str):
        return f"Not correct. {task.question}"
    a, e = _array(answer), np.asarray(expected, dtype=np.float64)
    if answer is None:
        return f"Your answer is None. {task.question}"
    if isinstance(answer, str):
        return f"This exercise expects a number without words or units. {task.question}"
    if a is None:
        return f"This exercise expects a number or an array, not {type(answer).__name__}."
    if np.squeeze(a).shape != np.squeeze(e).shape:
        return f"The shape of the answer should be {e.shape}; yours is {a.shape}."
    if not np.isfinite(a).all():
        return "Your answer contains NaN or infinite values. Check for a division by zero."
    if e.size == 1 and not task.up_to_scale and np.abs(e).max() > 0:
        size = "small" if float(a.ravel()[0]) < float(e.ravel()[0]) else "large"
        return f"Not correct: your value is too {size}. {task.question}"
    if not task.up_to_scale and np.allclose(
        -a, e, rtol=0, atol=task.tolerance * max(np.abs(e).max(), 1e-12)
    ):
        return "Only the sign is wrong."
    if (
        np.squeeze(a).ndim == 2
        and a.shape == e.T.shape
        and _same(np.squeeze(a).T, np.squeeze(e), task)
    ):
        return "Your matrix is the transpose of the correct one."
    return f"Not correct. {task.question}"
