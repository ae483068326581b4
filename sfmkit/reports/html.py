"""``sfmkit report``: show all benchmarks of a folder on one page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from .._utils.writing import atomic_write, check_file
from ..errors import InputError
from . import page
from .result import FILE, Result, ResultTable, read_result

PAGE = "report.html"
_ORDER = ("oxford", "fountain", "uav")  # as in the paper; others follow by name
_INTRO = (
    "Two-view structure from motion with several feature operators: the experiments of Dippold & "
    "Tsai (Two-View Structure-from-Motion with Multiple Feature Detector Operators), repeated. The "
    "coloured columns contain the paper's own values, beside ours.",
)


def find_results(folder: str | os.PathLike) -> list[Path]:
    """Find the results in `folder` and directly below it, in the order of the page.

    Raises:
        InputError: the folder does not exist or contains no result.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            f"there is no folder {folder}; `sfmkit bench` writes results, by default below out/"
        )
    found = [path.parent for path in (folder / FILE, *folder.glob(f"*/{FILE}")) if path.is_file()]
    if not found:
        raise InputError(
            f"{folder} holds no results (no {FILE} in it or in a folder below); run "
            "`sfmkit bench oxford`, `fountain` or `uav` first, with --out in that folder"
        )
    return sorted(
        found, key=lambda f: (_ORDER.index(f.name) if f.name in _ORDER else len(_ORDER), f.name)
    )


def write_report(folder: str | os.PathLike, out: str | os.PathLike | None = None) -> Path:
    """Write the page of all results below `folder`.

    Args:
        out: the file; None for ``report.html`` in the folder.

    Raises:
        InputError: no results, or a damaged one.
        OutputError: the file cannot be written.
    """
    folders = find_results(folder)
    path = Path(folder) / PAGE if out is None else Path(out)
    check_file(path)
    results = [read_result(f) for f in folders]
    text = page.page(
        "sfmkit: the paper's experiments",
        _INTRO,
        [(r.title, section(r, f)) for r, f in zip(results, folders)],
    )
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def section(result: Result, folder: Path) -> str:
    """Make the section of a benchmark: command, tables, figures and circumstances."""
    parts = [page.code(result.command), page.paragraphs(result.notes)]
    parts += [table_html(table) for table in result.tables]
    parts += [
        page.figure(figure.title, folder / figure.file, figure.alt) for figure in result.figures
    ]
    parts += [page.heading("Machine and versions"), page.facts(circumstances(result))]
    return "".join(parts)


def table_html(table: ResultTable) -> str:
    """Convert a result's table to HTML."""
    return page.table(
        table.title,
        [column.name for column in table.columns],
        table.shown(),
        right=[column.right for column in table.columns],
        marked=[column.paper for column in table.columns],
        note=table.note,
    )


def circumstances(result: Result) -> Sequence[tuple[str, str]]:
    """Return machine, versions and seeds as pairs of term and text."""
    seeds = ", ".join(map(str, result.seeds)) or "none"
    versions = ", ".join(f"{name} {number}" for name, number in result.versions.items())
    return [*result.machine.items(), ("versions", versions), ("seeds", seeds)]
