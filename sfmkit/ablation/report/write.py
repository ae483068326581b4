"""The report of sweeps: a page, tables and plots."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..._utils.progress import Progress, silent
from ..._utils.writing import check_free, staged_folder
from ...errors import InputError
from ...reports.latex import latex_table
from ...reports.result import Result, ResultFigure, ResultTable, write_result
from .. import read_table
from .figures import draw_ranking, figures
from .findings import Findings, analyse, answers, overall
from .page import Section, ablation_page
from .scores import COLUMNS, Ablation, score
from .tables import ranking_table, tables
from .units import Choice

FOLDER, PAGE = "report", "report.html"


_NOTES = (
    "A setup is a combination of operators with a preset. All are compared by the area under the "
    "curve (AUC) of the share of "
    "runs whose error is below e, for e from 0 to a threshold, divided by the threshold: 1 means "
    "no error, 0 that no run has an error "
    "below the threshold. A run without an answer, or that failed, counts in every number as the "
    "largest error; nothing is left out.",
    "Intervals contain the true value in about 95 of 100 such experiments. They are bootstrap "
    "intervals over the scenes of a data set, or over its pairs if it has fewer than five scenes "
    "(--units changes this). A scene is drawn with all of its pairs and a pair with all of its "
    "seeds, because neither the pairs of one scene nor the seeds of one pair are independent: only "
    "more scenes say more about other scenes. When two intervals overlap, the difference can still "
    "be real, because both setups ran on the same pairs: see the table of differences.",
    "A p-value is the probability of a difference at least as large as this one if there is none. "
    "Among hundreds of differences some "
    "are large by chance, so p-values are corrected by Holm's method for all that are tested "
    "together. 'Not shown' does not mean "
    "equal: it means that these data do not suffice. The interval is that of the mean, which a few "
    "hard pairs can change; the test examines whether the scenes or pairs agree. Where only the "
    "interval excludes zero, a few pairs decide: look at them. The best setup was chosen on the "
    "same pairs, so its score is slightly too high.",
)


@dataclass(frozen=True, eq=False)
class Report:
    """The files of a report.

    Attributes:
        page: the HTML file.
        files: all files, the page among them.
        sections: the parts of the page, with the answers.
        findings: one for each data set.
    """

    page: Path
    files: tuple[Path, ...]
    sections: tuple[Section, ...]
    findings: tuple[Findings, ...]


def write_report(
    sweeps: str | os.PathLike | Sequence[str | os.PathLike],
    out: str | os.PathLike | None = None,
    *,
    threshold_px: float | None = None,
    threshold_deg: float | None = None,
    units: Choice = "auto",
    say: Progress = silent,
) -> Report:
    """Write the report of one or several sweeps; it replaces an earlier one when it is complete.

    Args:
        sweeps: The folder of a sweep, or several: of other data sets, or shards of one sweep.
        out: The folder to write; None for ``report/`` in the folder of a single sweep.
        threshold_px, threshold_deg, units: See :func:`~.scores.score`.
        say: Progress.

    Raises:
        InputError: A folder holds no finished sweep, none has a truth, two hold the same rows, or
            there are several and `out` is None.
        OutputError: The report cannot be written.
    """
    folders = [sweeps] if isinstance(sweeps, (str, os.PathLike)) else list(sweeps)
    out = _out_folder(folders, out)
    check_free(out, overwrite=True)
    circumstances = _Circumstances()
    ablation = score(
        _rows(folders, circumstances, say),
        threshold_px=threshold_px,
        threshold_deg=threshold_deg,
        units=units,
    )
    findings = []
    for block in ablation.blocks:
        say("analyse", block.dataset)
        findings.append(analyse(block))
    with staged_folder(out, overwrite=True) as staged:
        sections = []
        for f in findings:
            say("draw", f.scores.dataset)
            sections.append(_section(f, staged))
        together = _together(ablation, staged)
        if together is not None:
            sections.append(together)
        result = _result(circumstances, ablation, sections)
        write_result(staged, result)
        for t in result.tables:
            (staged / f"{t.name}.tex").write_text(latex_table(t), encoding="utf-8")
        facts = {
            "made by": result.command,
            **result.machine,
            "versions": ", ".join(map(" ".join, result.versions.items())),
        }
        text = ablation_page(result.title, _lead(ablation), sections, _NOTES, facts, staged)
        (staged / PAGE).write_text(text, encoding="utf-8")
        names = sorted(file.name for file in staged.iterdir())
    return Report(out / PAGE, tuple(out / name for name in names), tuple(sections), tuple(findings))


def _out_folder(folders: Sequence[str | os.PathLike], out: str | os.PathLike | None) -> Path:
    if not folders:
        raise InputError("name the folders of the sweeps")
    if out is not None:
        return Path(out)
    if len(folders) > 1:
        raise InputError("name a folder for the report of several sweeps: --out FOLDER")
    only = Path(folders[0])
    return (only if only.is_dir() else only.parent) / FOLDER


@dataclass
class _Circumstances:
    """What the rows say about how they were made."""

    machines: set[str] = field(default_factory=set)
    versions: set[str] = field(default_factory=set)
    seeds: set[int] = field(default_factory=set)


def _rows(
    folders: Sequence[str | os.PathLike], circumstances: _Circumstances, say: Progress
) -> Iterator[Mapping[str, Any]]:
    """The rows of all sweeps; one sweep is in memory at a time."""
    for folder in folders:
        say("read", str(folder))
        table = read_table(folder)
        circumstances.machines |= set(filter(None, table["machine"]))
        circumstances.versions |= set(filter(None, table["versions"]))
        circumstances.seeds |= set(table["seed"])
        yield from table.rows_of(COLUMNS)


def _section(f: Findings, folder: Path) -> Section:
    made = tables(f)
    return Section(
        f.scores.dataset,
        tuple(answers(f)),
        tuple(made),
        tuple(figures(f, folder)),
        frozenset(t.name for t in made if t.name.endswith("-differences")),
    )


def _together(ablation: Ablation, folder: Path) -> Section | None:
    """The ranking over all data sets."""
    found = overall(ablation)
    if found is None:
        return None
    labels, ranking = found
    name = "all data sets together"
    setups = ablation.blocks[0].setups
    best = [labels[c] for c in ranking.order]
    first = next((g for g in ranking.groups if g[0] == 0), (0, 0))
    words = (
        f"On average over all {ranking.blocks} {ranking.unit}s {best[0]} ranks first "
        f"({ranking.average[ranking.order[0]]:.2f} of {len(labels)}); "
        + (
            f"{first[1]} others are within the critical difference of it."
            if first[1]
            else "no other is within the critical difference of it."
        ),
    )
    return Section(
        name.capitalize(),
        words,
        (ranking_table(name, labels, ranking),),
        (draw_ranking(name, labels, setups, ranking, folder),),
    )


def _lead(ablation: Ablation) -> str:
    left = ", ".join(f"{n:,} rows of {name}" for name, n in ablation.without_truth.items())
    return (
        "Which detectors help, on which data, by how much, and with which uncertainty? The page "
        "starts with the answers for each data set; tables and figures follow."
        + (f" Not evaluated, because there is no true geometry: {left}." if left else "")
    )


def _result(made_by: _Circumstances, ablation: Ablation, sections: list[Section]) -> Result:
    made: tuple[ResultTable, ...] = tuple(t for s in sections for t in s.tables)
    drawn: tuple[ResultFigure, ...] = tuple(f for s in sections for f in s.figures)
    pairs = sum(len(b.pairs) for b in ablation.blocks)
    setups = max(len(b.setups) for b in ablation.blocks)
    versions = sorted(made_by.versions)
    if not versions:
        raise InputError(
            "every run of this ablation failed, so there is nothing to compare; the column "
            "`failure` says why"
        )
    return Result(
        name="ablation",
        title=(
            f"Ablation: {setups} setups on {pairs} pairs of "
            f"{', '.join(b.dataset for b in ablation.blocks)}"
        ),
        command="sfmkit ablate report",
        tables=made,
        figures=drawn,
        seeds=tuple(sorted(made_by.seeds)),
        notes=(*(f"{s.title}: {a}" for s in sections for a in s.answers), *_NOTES),
        machine={"machine": "; ".join(sorted(made_by.machines))},
        versions=dict(part.rsplit(" ", 1) for part in versions[-1].split(", ")),
    )
