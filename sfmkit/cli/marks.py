"""``sfmkit marks``: tables of the marks of a class."""

from __future__ import annotations

import csv
import io
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..teaching.marks import Result


@click.command()
@click.argument(
    "files", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option(
    "--csv",
    "table",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Also write one row per student and exercise to this file.",
)
def marks(files: tuple[Path, ...], table: Path | None) -> None:
    """Merge the marks files of a class (`sfmkit lab --class`) into a table.

    Lines that occur in several files count once.
    """
    from .._utils.writing import atomic_write
    from ..teaching.marks import read_marks, results

    rows = results(read_marks(files))
    if table is not None:
        with atomic_write(table) as temporary:
            temporary.write_text(as_csv(rows), encoding="utf-8")
    for line in [*by_student(rows), "", *by_exercise(rows)]:
        click.echo(line)


def as_csv(rows: Sequence[Result]) -> str:
    """Return one row per student and exercise."""
    from ..teaching.marks import Result

    memory = io.StringIO()
    writer = csv.DictWriter(memory, [field.name for field in fields(Result)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return memory.getvalue()


def by_student(rows: Sequence[Result]) -> list[str]:
    """Return the table of students: exercises solved per notebook, tries, hints and time."""
    notebooks = sorted({row.exercise[:2] for row in rows})
    students: dict[str, list[Result]] = defaultdict(list)
    for row in rows:
        students[row.student].append(row)
    width = max([len("student"), *map(len, students)])
    head = "  ".join([f"{'student':<{width}}", *(f"{n:>4}" for n in notebooks), "solved"])
    lines = [f"{head}  {'tries':>5}  {'hints':>5}  {'minutes':>7}"]
    for name, own in students.items():
        solved = Counter(row.exercise[:2] for row in own if row.solved)
        cells = "  ".join(f"{solved[n]:>4}" for n in notebooks)
        tries, hints = sum(row.tries for row in own), sum(row.hint > 0 for row in own)
        minutes = sum(row.minutes for row in own)
        lines.append(
            f"{name:<{width}}  {cells}  {sum(solved.values()):>6}  {tries:>5}  {hints:>5}  "
            f"{minutes:>7.1f}"
        )
    return lines


def by_exercise(rows: Sequence[Result]) -> list[str]:
    """Return the table of exercises: how many students tried and solved them, and how."""
    exercises: dict[str, list[Result]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: row.exercise):
        exercises[row.exercise].append(row)
    lines = ["exercise  students  solved  median tries  with hints"]
    for number, own in exercises.items():
        solved = sum(row.solved for row in own)
        hints = sum(row.hint > 0 for row in own)
        tries = median(row.tries for row in own)
        lines.append(f"{number:<8}  {len(own):>8}  {solved:>6}  {tries:>12g}  {hints:>10}")
    return lines
