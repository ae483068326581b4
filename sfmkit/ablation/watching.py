"""Progress bar and overview of a sweep, in a terminal or a notebook."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as Bars
from rich.table import Table
from rich.text import Text

from .run import SweepState, Watcher
from .table import FAILED, AblationTable

_WIDTH = 130  # characters of the overview in a file
_LONGEST = 30  # lines of the overview


def duration(seconds: float) -> str:
    """Write seconds as ``45 s``, ``12 min`` or ``3.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class _Left(ProgressColumn):
    """The estimated time left."""

    def render(self, task: Task) -> Text:
        left = task.fields.get("left")
        return Text("" if left is None else f"{duration(left)} left")


@contextmanager
def bar(enabled: bool = True, console: Console | None = None) -> Iterator[Watcher]:
    """Show a progress bar for ``ablate(progress=...)``, in a terminal or a notebook.

    >>> with bar() as watch:
    ...     table = ablate("planes", progress=watch)
    """
    if not enabled:
        yield lambda progress: None
        return
    columns = (
        TextColumn("{task.fields[stage]:<5}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        _Left(),
        TextColumn("{task.description}"),
    )
    with Bars(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=None, stage="plan", left=None)

        def watch(p: SweepState) -> None:
            for note in p.notes:
                bars.console.print(note, style="yellow", highlight=False)
            counts = {"completed": p.done, "total": p.total} if p.total else {}
            bars.update(task, description=p.what, stage=p.stage, left=p.seconds_left, **counts)  # type: ignore[arg-type]

        yield watch


def print_overview(table: AblationTable) -> None:
    """Print median error, failures and time of every data set and combination."""
    groups: dict[tuple[str, str, str], list[dict]] = {}
    for row in table:
        groups.setdefault((row["dataset"], row["combination"], row["preset"]), []).append(row)
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)  # a file has no width
    shown = Table(
        "data",
        "combination",
        "preset",
        "median error",
        "no estimate",
        "failed",
        "inliers",
        "seconds",
    )
    for column in shown.columns[3:]:
        column.justify = "right"
    best = sorted(groups.items(), key=lambda item: (item[0][0], _median_error(item[1])))
    for (dataset, combination, preset), rows in best[:_LONGEST]:
        error = _median_error(rows)
        failed = sum(r["status"] == FAILED for r in rows)
        none = sum(r["status"] not in (FAILED, "ok") for r in rows)
        inliers = np.median([r["inliers"] for r in rows if r["inliers"] is not None] or [0])
        seconds = np.median([r["seconds"] for r in rows if r["seconds"] is not None] or [0])
        unit = rows[0]["error_unit"]
        shown.add_row(
            dataset,
            combination,
            preset,
            "-" if np.isinf(error) else f"{error:.3g} {unit}",
            f"{none} of {len(rows)}",
            f"{failed}",
            f"{inliers:,.0f}",
            f"{seconds:.2f}",
        )
    console.print(shown)
    if len(best) > _LONGEST:
        console.print(f"... and {len(best) - _LONGEST} more lines")
    reasons = {
        f"{r['dataset']}/{r['sequence']} {r['pair']}: {r['failure']}"
        for r in table
        if r["status"] == FAILED
    }
    for reason in sorted(reasons)[:5]:
        console.print(reason, style="yellow", highlight=False)


def _median_error(rows: list[dict]) -> float:
    known = [r["error"] for r in rows if r["error"] is not None]
    return float(np.median(known)) if known else float("inf")
