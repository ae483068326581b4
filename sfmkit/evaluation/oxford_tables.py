"""The paper's Tables 2 to 5 and Figures 7 to 10 from the rows of the Oxford benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._utils.writing import atomic_write
from ..metrics import error_auc
from ..pipeline.account import ALL
from ..reports.result import Cell, Column, Result, ResultFigure, ResultTable
from ..viz.colours import operator_colour
from .oxford import FLOOR, OURS, PAPERS
from .paper import OXFORD, OXFORD_FIGURES, OXFORD_TABLES
from .rows import Row

SOLVED_PX = 10.0  # mean corner error below which a pair counts as solved
SOLVED_PX_OFF = {("boat", "1-6"): 12.0}  # its ground truth is off by about 10 pixels


def solved(row: Row) -> bool:
    """Return whether the corner error of an estimate is below the limit of its pair."""
    limit = SOLVED_PX_OFF.get((row["sequence"], row["pair"]), SOLVED_PX)
    return row["corner_error_px"] is not None and row["corner_error_px"] < limit


def estimates(rows: Sequence[Row], **wanted: object) -> list[Row]:
    """Return the rows of estimates whose fields have these values."""
    return [
        r for r in rows if r["kind"] == "estimate" and all(r[k] == v for k, v in wanted.items())
    ]


def sequence_rmse(
    rows: Sequence[Row], *, only_solved: bool
) -> tuple[float, float, float, int, int]:
    """Compute the mean RMSE over the pairs for every seed.

    Args:
        rows: Estimates of one sequence, operator and recipe.
        only_solved: Average over the solved pairs; otherwise over the pairs with an estimate.

    Returns:
        Median, smallest and largest mean over the seeds (NaN without any pair), the number of
        pairs solved in every seed, and the number of pairs.
    """
    means = []
    for seed in sorted({r["seed"] for r in rows}):
        values = [
            r["rmse"]
            for r in rows
            if r["seed"] == seed and r["rmse"] is not None and (solved(r) or not only_solved)
        ]
        means.append(np.mean(values) if values else np.nan)
    pairs = sorted({r["pair"] for r in rows})
    every = sum(all(solved(r) for r in rows if r["pair"] == p) for p in pairs)
    return float(np.median(means)), float(np.min(means)), float(np.max(means)), every, len(pairs)


def oxford_result(rows: Sequence[Row], folder: Path, command: str) -> Result:
    """Make the tables of the rows, and draw the figures into `folder`."""
    mine = estimates(rows)
    pairs = {(r["sequence"], r["pair"]) for r in mine}
    operators = ", ".join(operators_of(rows)).replace(f"{ALL}, ", "")
    return Result(
        name="oxford",
        title=f"Homographies of the Oxford set: {len(pairs)} pairs, {operators}",
        command=command,
        tables=tuple(tables(rows)),
        figures=tuple(draw_figures(rows, folder)),
        seeds=tuple(sorted({r["seed"] for r in mine})),
        notes=(
            "The paper gives the RMSE of H in metres, but it has no consistent unit: with h33 = 1, "
            "two elements of H are translations in pixels, and the other ones are pure numbers or "
            "per pixel. The translations dominate the RMSE.",
            "The floor is the error of a fit to the fused matches that agree with the ground "
            "truth within 3 px. An estimate from these matches cannot be much better.",
        ),
    )


def operators_of(rows: Sequence[Row]) -> list[str]:
    """List the operators of the rows; all together come first."""
    return sorted(
        dict.fromkeys(r["operator"] for r in estimates(rows)), key=lambda name: name != ALL
    )


def tables(rows: Sequence[Row]) -> list[ResultTable]:
    """Make the paper's Tables 2 to 5, as far as there are rows, and tables of standard measures."""
    made = []
    for number, names in OXFORD_TABLES.items():
        here = [name for name in names if estimates(rows, sequence=name)]
        if here:
            made.append(_paper_table(rows, number, here))
    return [*made, _corner_table(rows), _feature_table(rows)]


def _paper_table(rows: Sequence[Row], number: int, sequences: Sequence[str]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for sequence in sequences:
        floors = [r["rmse"] for r in rows if r["kind"] == FLOOR and r["sequence"] == sequence]
        lines.append((sequence, "floor of the ground truth", float(np.mean(floors)), *[None] * 8))
        for operator in operators_of(rows):
            mine = estimates(rows, sequence=sequence, operator=operator, recipe=OURS)
            theirs = estimates(rows, sequence=sequence, operator=operator, recipe=PAPERS)
            ours, low, high, n, of = sequence_rmse(mine, only_solved=True)
            again, *_, m, _ = sequence_rmse(theirs, only_solved=False)
            rmse, features = OXFORD.get(operator, {}).get(sequence, (None, None))
            lines.append(
                (
                    "",
                    operator,
                    ours,
                    "" if np.isnan(ours) else f"{low:.2f}–{high:.2f}",
                    f"{n}/{of}",
                    None if rmse is None else ours - rmse,
                    rmse,
                    again,
                    f"{m}/{of}",
                    float(np.mean([r["matches"] for r in theirs])),
                    features,
                )
            )
    return ResultTable(
        f"table-{number}",
        f"Table {number}: mean RMSE of H, {' and '.join(sequences)}",
        (
            Column("sequence"),
            Column("operator"),
            Column("ours", ".2f"),
            Column("over seeds", ">"),
            Column("solved", ">"),
            Column("ours less paper", "+.2f"),
            Column("paper", ".2f", paper=True),
            Column("paper's method, rerun", ".2f"),
            Column("rerun solved", ">"),
            Column("matches", ",.0f"),
            Column("paper: features", ",", paper=True),
        ),
        tuple(lines),
        "Ours: mean over the solved pairs, median over the seeds. Paper's method, rerun: the "
        "method of the paper on the same matches, mean over the pairs with an estimate, right or "
        "wrong. Solved: pairs solved in every seed.",
    )


def _corner_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for operator in operators_of(rows):
        for recipe in (OURS, PAPERS):
            mine = estimates(rows, operator=operator, recipe=recipe)
            pairs = {(r["sequence"], r["pair"]) for r in mine}
            every = sum(
                all(solved(r) for r in mine if (r["sequence"], r["pair"]) == p) for p in pairs
            )
            wrong = sum(r["rmse"] is not None and not solved(r) for r in mine)
            errors = [
                np.inf if r["corner_error_px"] is None else r["corner_error_px"] for r in mine
            ]
            auc = error_auc(errors, (1, 3, 5, 10))
            seconds = float(np.median([r["seconds"] for r in mine]))
            lines.append(
                (operator, recipe, f"{every}/{len(pairs)}", f"{wrong}/{len(mine)}", *auc, seconds)
            )
    columns = (
        Column("operator"),
        Column("recipe"),
        Column("solved in every seed", ">"),
        Column("wrong, not refused", ">"),
        *(Column(f"AUC {t} px", ".3f") for t in (1, 3, 5, 10)),
        Column("s per pair", ".2f"),
    )
    note = (
        f"A pair is solved if its mean corner error is below {SOLVED_PX:g} px ("
        + ", ".join(
            f"{px:g} px on {' '.join(pair)}, whose ground truth is inaccurate"
            for pair, px in SOLVED_PX_OFF.items()
        )
        + "). AUC: area under the cumulative curve of the corner errors."
    )
    return ResultTable("corners", "All pairs: corner error", columns, tuple(lines), note)


def _feature_table(rows: Sequence[Row]) -> ResultTable:
    shown = (1, 3, 5, 10)
    mine = [r for r in rows if r["kind"] == "features"]
    lines: list[tuple[Cell, ...]] = []
    for operator in dict.fromkeys(r["operator"] for r in mine):
        r = [row for row in mine if row["operator"] == operator]
        mma = np.mean([row["mma"] for row in r], axis=0)
        means = [
            float(np.mean([row[key] for row in r]))
            for key in ("keypoints", "matches", "repeatability", "matching_score")
        ]
        lines.append(
            (
                operator,
                *means,
                *(float(mma[t - 1]) for t in shown),
                float(np.mean([w["seconds"] for w in r])),
            )
        )
    columns = (
        Column("operator"),
        Column("keypoints", ",.0f"),
        Column("matches", ",.0f"),
        Column("repeatability", ".3f"),
        Column("matching score", ".3f"),
        *(Column(f"MMA {t} px", ".3f") for t in shown),
        Column("s per pair", ".2f"),
    )
    note = (
        "MMA: mean matching accuracy, the share of the matches within this distance of the truth."
    )
    return ResultTable("operators", "Operators: means over the pairs", columns, tuple(lines), note)


def draw_figures(rows: Sequence[Row], folder: Path) -> list[ResultFigure]:
    """Draw Figures 7 to 10 as PNG files, with one bar per pair and operator on a log axis.

    The upper row shows the method of sfmkit, the lower row that of the paper.
    """
    operators = operators_of(rows)
    drawn = []
    for number, names in OXFORD_FIGURES.items():
        here = [name for name in names if estimates(rows, sequence=name)]
        if not here:
            continue
        figure = Figure(figsize=(5.5 * len(here), 6.5), layout="constrained")
        axes = figure.subplots(2, len(here), sharey="col", squeeze=False)
        for column, sequence in enumerate(here):
            pairs = sorted({r["pair"] for r in estimates(rows, sequence=sequence)})
            for line, (recipe, title) in enumerate(
                ((OURS, "ours"), (PAPERS, "the paper's method"))
            ):
                ax = axes[line, column]
                for k, operator in enumerate(operators):
                    mine = estimates(rows, sequence=sequence, operator=operator, recipe=recipe)
                    values = [
                        [r["rmse"] for r in mine if r["pair"] == p and r["rmse"] is not None]
                        for p in pairs
                    ]
                    heights = [np.median(v) if v else np.nan for v in values]
                    at = np.arange(len(pairs)) + (k - (len(operators) - 1) / 2) * 0.8 / len(
                        operators
                    )
                    ax.bar(
                        at,
                        heights,
                        0.8 / len(operators),
                        label=operator,
                        color=operator_colour(operator),
                    )
                floors = {
                    r["pair"]: r["rmse"]
                    for r in rows
                    if r["kind"] == FLOOR and r["sequence"] == sequence
                }
                for x, p in enumerate(pairs):
                    ax.hlines(
                        floors[p],
                        x - 0.45,
                        x + 0.45,
                        colors="black",
                        linestyles="dotted",
                        linewidth=1,
                    )
                ax.set(yscale="log", title=f"{sequence}, {title}", ylabel="RMSE of H")
                ax.set_xticks(range(len(pairs)), [f"I{p.replace('-', '')}" for p in pairs])
                ax.grid(axis="y", alpha=0.3)
        axes[0, 0].legend(fontsize=8)
        figure.suptitle(
            f"Figure {number}; dotted: floor of the ground truth; no bar: too little evidence",
            fontsize=10,
        )
        file = folder / f"figure{number:02d}.png"
        with atomic_write(file) as temporary:
            FigureCanvasAgg(figure)
            figure.savefig(temporary, dpi=110, format="png")
        drawn.append(
            ResultFigure(
                f"Figure {number}: RMSE of H, pair by pair, {' and '.join(here)}",
                file.name,
                f"Bars on a log axis, one per operator and pair of {' and '.join(here)}. Above: "
                "the method of sfmkit; below: that of the paper. The dotted line is the floor of "
                "the ground truth. There is no bar if there was too little evidence.",
            )
        )
    return drawn
