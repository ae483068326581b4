"""Marks of a class: one file per student with one line per check, and their summary.

A line is a JSON object with the fields of :class:`Mark`. The files stay on this machine.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

from ..errors import InputError

__all__ = ["Mark", "Result", "append_mark", "current_class", "read_marks", "results"]

STUDENT, FILE = "SFMKIT_STUDENT", "SFMKIT_MARKS"  # set by `sfmkit lab --class`


@dataclass(frozen=True)
class Mark:
    """One check of an answer.

    Attributes:
        student: Name of the student.
        exercise: Number of the exercise, such as ``04.1``.
        right: Whether the answer was correct.
        answered: Whether there was an answer; a hint can be read without one.
        hint: Level of the hint that was printed, 0 for none.
        time: Time of the check, UTC, ISO 8601.
    """

    student: str
    exercise: str
    right: bool
    answered: bool
    hint: int
    time: str


@dataclass(frozen=True)
class Result:
    """The result of a student in an exercise.

    Attributes:
        student, exercise: As in :class:`Mark`.
        solved: Whether an answer was correct.
        tries: Number of answers up to the first correct one.
        hint: Highest level of the hints that were read before the first correct answer.
        minutes: Minutes from the first check to the first correct answer, or to the last check.
        first: Time of the first check.
    """

    student: str
    exercise: str
    solved: bool
    tries: int
    hint: int
    minutes: float
    first: str


def current_class() -> tuple[str, Path] | None:
    """Return the student and the marks file of `sfmkit lab --class`, None without a class."""
    student, file = os.environ.get(STUDENT), os.environ.get(FILE)
    return (student, Path(file)) if student and file else None


def append_mark(file: Path, student: str, exercise: str, right: bool, answered: bool, hint: int):
    """Append one line to a marks file.

    Raises:
        OSError: The file cannot be written.
    """
    now = datetime.now(UTC).isoformat(timespec="seconds")
    line = json.dumps(asdict(Mark(student, exercise, right, answered, hint, now)))
    # The kernels of several notebooks write to the file: append the line in a single write.
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        os.write(descriptor, f"{line}\n".encode())
    finally:
        os.close(descriptor)


def read_marks(files: Iterable[Path]) -> list[Mark]:
    """Read marks files; a line that occurs in several of them counts once.

    Raises:
        InputError: A file cannot be read, or a line is not a mark.
    """
    found: dict[tuple[Mark, int], Mark] = {}
    for file in files:
        try:
            lines = file.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{file} cannot be read: {error}") from error
        seen: dict[Mark, int] = defaultdict(int)
        for number, line in enumerate(lines, start=1):
            if line.strip():
                mark = _parsed(line, f"{file}, line {number}")
                seen[mark] += 1  # equal checks within one second are different checks
                found[mark, seen[mark]] = mark
    return sorted(found.values(), key=lambda mark: (mark.student, mark.exercise, mark.time))


def results(marks: Sequence[Mark]) -> list[Result]:
    """Summarise marks, one result per student and exercise, sorted by both."""
    groups: dict[tuple[str, str], list[Mark]] = defaultdict(list)
    for mark in marks:
        groups[mark.student, mark.exercise].append(mark)
    return [_result(*key, sorted(group, key=_time)) for key, group in sorted(groups.items())]


def _result(student: str, exercise: str, checks: list[Mark]) -> Result:
    end = next((k for k, mark in enumerate(checks) if mark.right), None)
    until = checks if end is None else checks[: end + 1]
    passed = _time(until[-1]) - _time(until[0])
    return Result(
        student=student,
        exercise=exercise,
        solved=end is not None,
        tries=sum(mark.answered for mark in until),
        hint=max(mark.hint for mark in until),
        minutes=round(passed.total_seconds() / 60, 1),
        first=until[0].time,
    )


def _time(mark: Mark) -> datetime:
    return datetime.fromisoformat(mark.time)


def _parsed(line: str, place: str) -> Mark:
    try:
        record = json.loads(line)
        mark = Mark(**{field.name: record[field.name] for field in fields(Mark)})
        kinds = (str, str, bool, bool, int, str)
        if not all(type(v) is kind for v, kind in zip(asdict(mark).values(), kinds)):
            raise TypeError("a field has the wrong type")
        if _time(mark).tzinfo is None:
            raise ValueError("the time has no time zone")
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{place} is not a mark: {error}") from error
    return mark
