"""A recording of the worst cases of an ablation.

``caseK/worst`` is the K-th worst case, ``caseK/best`` the run that did best on the same pair; see
:mod:`sfmkit.recording.pages`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..._utils.progress import Progress, silent
from ...recording.pages import RunPage, save_pages
from .worst import Case, describe, run_again


def save_worst(path: str | Path, cases: Sequence[Case], say: Progress = silent) -> None:
    """Run the cases again and write them to one .rrd file.

    Args:
        path: The file; it appears complete or not at all.
        cases: See :func:`sfmkit.ablation.report.worst.choose_worst`.
        say: Called with every run.

    Raises:
        ImageError: An image is missing.
        OutputError: The file cannot be written.
    """

    def pages() -> Iterator[tuple[str, Sequence[RunPage]]]:
        for number, case in enumerate(cases, start=1):
            yield f"{case.row['sequence']} {case.row['pair']}", _runs(case, number, say)

    save_pages(path, f"the {len(cases)} worst cases", pages())


def _runs(case: Case, number: int, say: Progress) -> list[RunPage]:
    runs = []
    H = case.pair["H"]
    for name, row in zip(("worst", "best"), case.runs):
        pair = f"{row['dataset']} {row['sequence']} {row['pair']}"
        say(f"case {number}", f"{pair}: {row['combination']}")
        again = run_again(case, row)
        H_true = None if H is None else np.array(H)
        runs.append(RunPage(name, describe(case, again), again.images, again.result, H_true))
    return runs
