"""``FOLDER/report/``: what a sweep shows, as a page, tables and plots."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ..._utils.progress import Progress, silent
from ..._utils.writing import check_free, staged_folder
from ...errors import InputError
from ...reports.latex import latex_table
from ...reports.result import Result, ResultFigure, ResultTable, write_result
from .. import AblationTable, read_table
from .figures import draw_ranking, figures
from .findings import Findings, analyse, answers, overall
from .page import Section, ablation_page
from .scores import Ablation, score
from .tables import ranking_table, tables

FOLDER, PAGE = "report", "report.html"


_NOTES = (
    "A setup is a combination of operators with a preset. All are compared by the area under the "
    "curve (AUC) of the share of "
    "runs whose error is below e, for e from 0 to a threshold, divided by the threshold: 1 means "
    "no error at all, 0 that no run came "
    "below the threshold. A run that gave no answer, or failed, is in every number as the worst "
    "there is; nothing is left out.",
    "Intervals hold the true value in about 95 of 100 such experiments. They are bootstrap "
    "intervals over the pairs, and a pair brings "
    "all its seeds along: more seeds sharpen the picture of these pairs, only more pairs say "
    "more about others. When two "
    "intervals overlap, the difference may still be real, for both setups ran on the same pairs: "
    "look it up among the differences.",
    "A p-value is the chance of a difference at least as large as this one if there were none. "
    "Among hundreds of differences some "
    "are large by chance, so p-values are corrected by Holm's method for all that are tested "
    "together. 'Not shown' does not mean "
    "equal: it means that these pairs cannot tell. The interval is of the mean, which a few hard "
    "pairs can move; the test asks whether "
    "the pairs agree. Where only the interval leaves zero out, a few pairs decide: look at them. "
    "The best was chosen on the same pairs, which flatters it a little.",
)


@dataclass(frozen=True, eq=False)
class Report:
    """What was written.

    Attributes:
        page: the HTML file.
        files: all files, the page among them.
        sections: its parts, with the answers.
        findings: one for each data set.
    """

    page: Path
    files: tuple[Path, ...]
    sections: tuple[Section, ...]
    findings: tuple[Findings, ...]


def write_report(sweep: str | os.PathLike, say: Progress = silent) -> Report:
    """Write ``report/`` into a sweep's folder; what was there before is replaced when the new one
    is complete.

    Raises:
        InputError: the folder holds no finished sweep, or none with a truth.
        OutputError: it cannot be written.
    """
    say("read", str(sweep))
    table = read_table(sweep)
    folder = Path(sweep) if Path(sweep).is_dir() else Path(sweep).parent
    check_free(folder / FOLDER, overwrite=True)
    ablation = score(table)
    findings = []
    for block in ablation.blocks:
        say("analyse", block.dataset)
        findings.append(analyse(block))
    with staged_folder(folder / FOLDER, overwrite=True) as staged:
        sections = []
        for f in findings:
            say("draw", f.scores.dataset)
            sections.append(_section(f, staged))
        together = _together(ablation, staged)
        if together is not None:
            sections.append(together)
        result = _result(table, ablation, sections)
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
    done = folder / FOLDER
    return Report(
        done / PAGE, tuple(done / name for name in names), tuple(sections), tuple(findings)
    )


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
        f"On average over all {ranking.pairs} pairs {best[0]} ranks first "
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
        "Which detectors help, on which data, by how much, and with which uncertainty? The "
        "answers first, for each data set; then what they rest on."
        + (f" Without a true geometry to compare with, and so not judged: {left}." if left else "")
    )


def _result(table: AblationTable, ablation: Ablation, sections: list[Section]) -> Result:
    made: tuple[ResultTable, ...] = tuple(t for s in sections for t in s.tables)
    drawn: tuple[ResultFigure, ...] = tuple(f for s in sections for f in s.figures)
    pairs = sum(len(b.pairs) for b in ablation.blocks)
    setups = max(len(b.setups) for b in ablation.blocks)
    machines = sorted({m for m in table["machine"] if m})
    versions = sorted({v for v in table["versions"] if v})
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
        seeds=tuple(sorted(set(table["seed"]))),
        notes=(*(f"{s.title}: {a}" for s in sections for a in s.answers), *_NOTES),
        machine={"machine": "; ".join(machines)},
        versions=dict(part.rsplit(" ", 1) for part in versions[-1].split(", ")),
    )
