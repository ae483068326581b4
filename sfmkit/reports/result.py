"""What a benchmark hands over: tables, figures and the circumstances, in a folder that
``sfmkit report`` reads.

``FOLDER/result.json`` holds everything but the pictures, which lie beside it; every table is also
there as CSV, for spreadsheets, and as Markdown, for pages.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

from .._utils.machine import describe_machine
from .._utils.markdown import escape, table_row
from .._utils.versions import all_versions
from .._utils.writing import atomic_write
from ..errors import InputError

FILE = "result.json"
VERSION = 2
MINUS = "−"

Range = tuple[float, float]
Cell = str | int | float | Range | None


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: its head, with the unit.
        spec: Python's format specification of its numbers, e.g. ``,`` or ``.2f``; ``>`` for text
            that is set to the right; empty for text.
        paper: whether it holds the paper's own values.
        interval: whether its cells are intervals (low, high); a CSV file has two columns of
            numbers for it.
    """

    name: str
    spec: str = ""
    paper: bool = False
    interval: bool = False

    @property
    def right(self) -> bool:
        """Whether its cells are set to the right."""
        return bool(self.spec)

    @property
    def heads(self) -> tuple[str, ...]:
        """Its heads in a CSV file."""
        return (f"{self.name}, low", f"{self.name}, high") if self.interval else (self.name,)

    def values(self, cell: Cell) -> tuple[str | int | float | None, ...]:
        """A cell as the cells of a CSV file."""
        if isinstance(cell, tuple):
            return tuple(map(_number, cell))
        return (None, None) if self.interval else (cell,)

    def show(self, cell: Cell) -> str:
        """A cell as it is printed; nothing for None and NaN."""
        if isinstance(cell, tuple):
            low, high = map(Column("", self.spec).show, cell)
            return f"{low} to {high}" if low and high else ""
        if cell is None or (isinstance(cell, float) and math.isnan(cell)):
            return ""
        if isinstance(cell, str):
            return cell
        text = format(cell, self.spec if self.spec != ">" else "")
        return MINUS + text[1:] if text.startswith("-") else text


@dataclass(frozen=True)
class ResultTable:
    """A table: `rows` of cells, one for each of the `columns`; a row's None is an empty cell.

    Attributes:
        name: short and unique within a result, of letters, digits and hyphens: the name of its
            files.
        title, note: what it shows, and how to read it.

    Raises:
        InputError: rows of another length than the columns, cells that cannot be shown, a bad name.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9-]+", self.name):
            raise InputError(
                f"a table's name is of small letters, digits and hyphens, not {self.name!r}"
            )
        if not self.columns:
            raise InputError(f"table {self.name} has no columns")
        heads = [head for column in self.columns for head in column.heads]
        if len(set(heads)) < len(heads):
            twice = next(head for head in heads if heads.count(head) > 1)
            raise InputError(f"table {self.name} has two columns '{twice}'")
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(
                    f"table {self.name} has {len(self.columns)} columns and a row of {len(row)} "
                    "cells"
                )
            for column, cell in zip(self.columns, row):
                if column.interval and cell is not None and not _is_range(cell):
                    raise InputError(
                        f"table {self.name}, column {column.name}: {cell!r} is not an interval"
                    )
                if column.interval:
                    continue
                if isinstance(cell, bool) or not isinstance(cell, (str, int, float, type(None))):
                    raise InputError(
                        f"table {self.name}, column {column.name}: {cell!r} is neither text nor "
                        "a number"
                    )
                try:
                    column.show(cell)
                except ValueError as error:
                    raise InputError(
                        f"table {self.name}, column {column.name}: {cell!r} cannot be shown"
                    ) from error

    def shown(self) -> list[list[str]]:
        """The cells as they are printed."""
        return [[column.show(cell) for column, cell in zip(self.columns, row)] for row in self.rows]

    def markdown(self) -> str:
        """As a Markdown table with its title above and its note below."""

        rule = ["--:" if column.right else ":--" for column in self.columns]
        parts = [
            f"**{escape(self.title)}**",
            "\n".join(
                [
                    table_row(c.name for c in self.columns),
                    f"| {' | '.join(rule)} |",
                    *map(table_row, self.shown()),
                ]
            ),
        ]
        return "\n\n".join([*parts, self.note] if self.note else parts) + "\n"

    def csv(self) -> str:
        """As comma-separated values: a number or a text per cell, numbers in full."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([head for column in self.columns for head in column.heads])
        for row in self.rows:
            writer.writerow([v for c, cell in zip(self.columns, row) for v in c.values(cell)])
        return text.getvalue()


@dataclass(frozen=True)
class ResultFigure:
    """A picture: its title, the name of its PNG file beside the result, and what it shows in
    words."""

    title: str
    file: str
    alt: str

    def __post_init__(self) -> None:
        if not self.file or PurePath(self.file).name != self.file or not self.file.endswith(".png"):
            raise InputError(f"a figure lies beside its result as a PNG file, not at {self.file!r}")


@dataclass(frozen=True)
class Result:
    """All that a benchmark has to show.

    Attributes:
        name: of the benchmark, e.g. ``oxford``.
        title: one line.
        command: what to type to make it again.
        tables, figures: in the order in which they are shown.
        seeds: that were used.
        notes: what a reader has to know, a sentence or paragraph each.
        machine, versions: what it was made on and with.
    """

    name: str
    title: str
    command: str
    tables: tuple[ResultTable, ...]
    figures: tuple[ResultFigure, ...] = ()
    seeds: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    machine: Mapping[str, str] = field(default_factory=describe_machine)
    versions: Mapping[str, str] = field(default_factory=all_versions)

    def __post_init__(self) -> None:
        names = [table.name for table in self.tables]
        if len(set(names)) < len(names):
            raise InputError(f"two tables of {self.name} have one name")


def write_result(folder: str | os.PathLike, result: Result) -> list[Path]:
    """Write ``result.json`` and the tables' files into a folder that exists and holds the figures.

    ``result.json`` comes last: where it is, the rest is complete.

    Returns:
        The files written.

    Raises:
        InputError: a figure is not there.
        OutputError: the folder cannot be written.
    """
    folder = Path(folder)
    for figure in result.figures:
        if not (folder / figure.file).is_file():
            raise InputError(f"the figure {folder / figure.file} was not drawn")
    texts: dict[str, str] = {}
    for table in result.tables:
        texts[f"{table.name}.csv"], texts[f"{table.name}.md"] = table.csv(), table.markdown()
    texts[FILE] = json.dumps(_plain(result), indent=1, allow_nan=False) + "\n"
    for name, text in texts.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def read_result(folder: str | os.PathLike) -> Result:
    """The result in a folder.

    Raises:
        InputError: there is none, it is damaged or of another version, or one of its pictures is
            missing.
    """
    path = Path(folder) / FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{folder} holds no {FILE}; `sfmkit bench` writes it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
    if not isinstance(data, dict) or data.get("version") != VERSION:
        found = data.get("version") if isinstance(data, dict) else type(data).__name__
        raise InputError(
            f"{path} is not a result of version {VERSION}, but {found}; run its benchmark again"
        )
    try:
        result = Result(
            name=_text(data["name"]),
            title=_text(data["title"]),
            command=_text(data["command"]),
            tables=tuple(_table(entry) for entry in data["tables"]),
            figures=tuple(
                ResultFigure(*(_text(e[k]) for k in ("title", "file", "alt")))
                for e in data["figures"]
            ),
            seeds=tuple(int(seed) for seed in data["seeds"]),
            notes=tuple(_text(note) for note in data["notes"]),
            machine={_text(k): _text(v) for k, v in data["machine"].items()},
            versions={_text(k): _text(v) for k, v in data["versions"].items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged ({error!r}); run its benchmark again") from error
    for figure in result.figures:
        if not (Path(folder) / figure.file).is_file():
            raise InputError(
                f"{path} names the picture {figure.file}, which is missing; run its benchmark again"
            )
    return result


def _plain(result: Result) -> dict[str, Any]:
    def cell(value: Cell) -> Any:
        if isinstance(value, tuple):
            return None if any(map(math.isnan, value)) else list(value)
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return {
        "version": VERSION,
        "name": result.name,
        "title": result.title,
        "command": result.command,
        "tables": [
            {
                "name": t.name,
                "title": t.title,
                "columns": [
                    {
                        "name": c.name,
                        "spec": c.spec,
                        "paper": c.paper,
                        "interval": c.interval,
                    }
                    for c in t.columns
                ],
                "rows": [[cell(v) for v in row] for row in t.rows],
                "note": t.note,
            }
            for t in result.tables
        ],
        "figures": [{"title": f.title, "file": f.file, "alt": f.alt} for f in result.figures],
        "seeds": list(result.seeds),
        "notes": list(result.notes),
        "machine": dict(result.machine),
        "versions": dict(result.versions),
    }


def _table(entry: dict[str, Any]) -> ResultTable:
    columns = tuple(
        Column(_text(c["name"]), _text(c["spec"]), bool(c["paper"]), bool(c["interval"]))
        for c in entry["columns"]
    )
    return ResultTable(
        _text(entry["name"]),
        _text(entry["title"]),
        columns,
        tuple(tuple(tuple(v) if isinstance(v, list) else v for v in r) for r in entry["rows"]),
        _text(entry["note"]),
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} where a text belongs")
    return value


def _is_range(cell: Cell) -> bool:
    return (
        isinstance(cell, tuple)
        and len(cell) == 2
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in cell)
    )


def _number(value: float) -> float | None:
    """The bound of an interval; None for NaN, which is an empty cell."""
    return None if math.isnan(value) else value
