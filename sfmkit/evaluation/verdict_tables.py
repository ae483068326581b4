"""Tables and the ROC figure of the benchmark of verdicts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..reports.result import Cell, Column, Result, ResultFigure, ResultTable
from ..types import Verdict
from .rows import Row
from .verdict import OURS, PEERS
from .verdict_figures import Curve, draw_roc

__all__ = ["RIGHT_DEG", "WRONG_DEG", "Rule", "rules", "verdict_result"]

RIGHT_DEG, WRONG_DEG = 5.0, 10.0
LEAST_INLIERS = (15, 30)
RIGHT, NEAR, WRONG, UNKNOWN = "right", "near", "wrong", "unknown"
ROC = "roc.png"


@dataclass(frozen=True)
class Rule:
    """A method and how it accepts a pose.

    Attributes:
        method: Name of the method in the rows.
        least: Smallest number of inliers; None for the verdict of sfmkit.
    """

    method: str
    least: int | None = None

    @property
    def name(self) -> str:
        """The name in tables."""
        return self.method if self.least is None else f"{self.method}, {self.least} inliers"

    def accepts(self, row: Row) -> bool:
        """Return whether the pose of a row is accepted; ambiguous poses are not."""
        if self.least is None:
            return row["pose"] and not is_ambiguous(row)
        return row["pose"] and row["inliers"] >= self.least


def rules() -> list[Rule]:
    """List the rules: the verdict of sfmkit, and the inlier thresholds of each other method."""
    return [Rule(OURS), *(Rule(name, k) for name in PEERS.values() for k in LEAST_INLIERS)]


def is_ambiguous(row: Row) -> bool:
    """Return whether the verdict of a row is ``ambiguous``."""
    return row["verdict"] == Verdict.AMBIGUOUS


def quality(row: Row) -> str:
    """Classify the pose of a row as right, near, wrong or unknown.

    A pose of a pair without a true pose is wrong, unless the pair has a solution that is unknown.
    """
    if not row["has_truth"]:
        return UNKNOWN if row["solvable"] else WRONG
    error = max(row["rotation_deg"], row["translation_deg"] or 0.0)
    return RIGHT if error <= RIGHT_DEG else NEAR if error <= WRONG_DEG else WRONG


def solved_pairs(rows: Sequence[Row]) -> set[str]:
    """Return the pairs for which any method found the right pose, accepted or not."""
    return {row["pair"] for row in rows if row["pose"] and quality(row) == RIGHT}


def verdict_result(rows: Sequence[Row], folder: str | os.PathLike, command: str) -> Result:
    """Make the tables of the rows, and draw the figure into `folder`.

    Args:
        rows: Rows of :func:`sfmkit.evaluation.verdict.bench_verdict`.
        folder: Folder of the figure ``roc.png``.
        command: Command that reproduces them.
    """
    solved = solved_pairs(rows)
    draw_roc(Path(folder) / ROC, _curves(rows, solved))
    pairs = len({row["pair"] for row in rows})
    return Result(
        name="verdict",
        title=f"Verdicts on {pairs:,} pairs",
        command=command,
        tables=(_methods(rows, solved), _groups(rows, solved)),
        figures=(
            ResultFigure(
                "Right poses accepted over wrong poses accepted",
                ROC,
                "One curve per method, from strict to lenient acceptance",
            ),
        ),
        notes=(
            f"A pose is right if the rotation and the direction of the translation are within "
            f"{RIGHT_DEG:g} degrees, and wrong beyond {WRONG_DEG:g} degrees or if there is no "
            "true pose. All methods get the same matches and an inlier threshold of 1 px. A pair "
            "is solved if any method finds the right pose, accepted or not.",
        ),
    )


def _methods(rows: Sequence[Row], solved: set[str]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for rule in rules():
        mine = [row for row in rows if row["method"] == rule.method]
        accepted = [row for row in mine if rule.accepts(row)]
        found = [quality(row) for row in accepted]
        unsure = [row for row in mine if rule.least is None and row["pose"] and is_ambiguous(row)]
        right = sum(quality(row) == RIGHT for row in accepted if row["pair"] in solved)
        refused = [row for row in mine if not row["pose"] or not rule.accepts(row)]
        lines.append(
            (
                rule.name,
                found.count(RIGHT),
                found.count(NEAR),
                sum(q == WRONG and row["solvable"] for q, row in zip(found, accepted)),
                sum(q == WRONG and not row["solvable"] for q, row in zip(found, accepted)),
                len(unsure),
                sum(row["pair"] in solved for row in refused) - _solved_among(unsure, solved),
                right / len(solved) if solved else None,
            )
        )
    columns = (
        Column("method"),
        Column("accepted, right", ","),
        Column(f"accepted, {RIGHT_DEG:g} to {WRONG_DEG:g} degrees off", ","),
        Column("accepted, wrong: solvable pairs", ","),
        Column("accepted, wrong: other pairs", ","),
        Column("ambiguous", ","),
        Column("refused though solved", ","),
        Column("solved pairs accepted, right", ".1%"),
    )
    return ResultTable("methods", "Accepted poses by method", columns, tuple(lines))


def _solved_among(rows: Sequence[Row], solved: set[str]) -> int:
    return sum(row["pair"] in solved for row in rows)


def _groups(rows: Sequence[Row], solved: set[str]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for group in dict.fromkeys(row["group"] for row in rows):
        part = [row for row in rows if row["group"] == group]
        ours = [row for row in part if row["method"] == OURS]
        accepted = [row for row in ours if Rule(OURS).accepts(row)]
        unsure = [row for row in ours if row["pose"] and is_ambiguous(row)]
        refused = [row for row in ours if not row["pose"] and row["pair"] in solved]
        wrong = [
            sum(
                rule.accepts(row) and quality(row) == WRONG
                for row in part
                if row["method"] == rule.method
            )
            for rule in rules()[1:]
        ]
        found = [quality(row) for row in accepted]
        lines.append(
            (
                group,
                len(ours),
                sum(row["pair"] in solved for row in ours),
                found.count(RIGHT),
                found.count(NEAR) + found.count(UNKNOWN),
                len(unsure),
                len(refused),
                found.count(WRONG),
                *(f"{a} / {b}" for a, b in zip(wrong[::2], wrong[1::2])),
            )
        )
    columns = (
        Column("pairs of"),
        Column("pairs", ","),
        Column("solved", ","),
        Column("accepted, right", ","),
        Column("accepted, near or unknown", ","),
        Column("ambiguous", ","),
        Column("refused though solved", ","),
        Column("accepted, wrong", ","),
        *(Column(f"wrong: {name}, {' / '.join(map(str, LEAST_INLIERS))}", ">") for name in PEERS),
    )
    note = "The columns before the last three are those of sfmkit."
    return ResultTable("groups", "Accepted poses by kind of pair", columns, tuple(lines), note)


def _curves(rows: Sequence[Row], solved: set[str]) -> list[Curve]:
    """Compute the ROC curve of each method, from strict to lenient acceptance."""
    curves = []
    for method in (OURS, *PEERS.values()):
        mine = [row for row in rows if row["method"] == method and row["pose"]]
        if method == OURS:
            mine = [row for row in mine if not is_ambiguous(row)]
        wrong, right, points = 0, 0, [(0, 0.0)]
        for row in sorted(mine, key=lambda row: -row["score"]):
            wrong += quality(row) == WRONG
            right += quality(row) == RIGHT
            points.append((wrong, right / max(len(solved), 1)))
        marks = []
        for rule in rules():
            if rule.method == method:
                kept = [quality(row) for row in mine if rule.accepts(row)]
                label = "verdict" if rule.least is None else f"{rule.least} inliers"
                at = kept.count(WRONG), kept.count(RIGHT) / max(len(solved), 1)
                marks.append((label, at))
        curves.append(Curve(method, tuple(points), tuple(marks)))
    return curves
