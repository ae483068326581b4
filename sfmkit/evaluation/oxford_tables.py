"""The paper's Tables 2 to 5 and Figures 7 to 10 from the rows of the Oxford benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.table import Table

from ..writing import atomic_write
from .metrics import error_auc
from .oxford import FLOOR, MULTI, OURS, PAPERS, Row
from .paper import OXFORD, OXFORD_FIGURES, OXFORD_TABLES

SOLVED_PX = 10.0  # mean corner error below which a pair counts as solved
SOLVED_PX_OFF = {("boat", "1-6"): 12.0}  # whose truth is itself about 10 pixels off


def solved(row: Row) -> bool:
    """Whether an estimate is right, as far as the truth can tell."""
    limit = SOLVED_PX_OFF.get((row["sequence"], row["pair"]), SOLVED_PX)
    return row["corner_error_px"] is not None and row["corner_error_px"] < limit


def estimates(rows: Sequence[Row], **wanted: object) -> list[Row]:
    """The rows of estimates whose fields have these values."""
    return [r for r in rows if r["kind"] == "estimate" and all(r[k] == v for k, v in wanted.items())]


def sequence_rmse(rows: Sequence[Row], *, only_solved: bool) -> tuple[float, float, float, int, int]:
    """Mean RMSE over the pairs, seed by seed.

    Args:
        rows: estimates of one sequence, operator and recipe.
        only_solved: leave out the pairs that are not; otherwise those without an estimate.

    Returns:
        median, lowest and highest over the seeds (NaN without any pair); pairs solved in every seed; pairs.
    """
    means = []
    for seed in sorted({r["seed"] for r in rows}):
        values = [
            r["rmse"] for r in rows if r["seed"] == seed and r["rmse"] is not None and (solved(r) or not only_solved)
        ]
        means.append(np.mean(values) if values else np.nan)
    pairs = sorted({r["pair"] for r in rows})
    every = sum(all(solved(r) for r in rows if r["pair"] == p) for p in pairs)
    return float(np.median(means)), float(np.min(means)), float(np.max(means)), every, len(pairs)


def tables(rows: Sequence[Row]) -> list[Table]:
    """One table for each of the paper's Tables 2 to 5 of which there are rows, and one of what the field measures."""
    operators = list(dict.fromkeys(r["operator"] for r in estimates(rows)))
    operators.sort(key=lambda name: name != MULTI)
    made = []
    for number, names in OXFORD_TABLES.items():
        here = [name for name in names if estimates(rows, sequence=name)]
        if not here:
            continue
        table = Table(
            title=f"Table {number}: mean RMSE of H (element-wise, h33 = 1; no unit)",
            title_justify="left",
            box=box.SIMPLE_HEAD,
        )
        for column in ("sequence", "operator", "ours", "solved", "difference", "paper", "its recipe", "solved"):
            table.add_column(column, justify="left" if column in ("sequence", "operator") else "right")
        table.add_column("matches", justify="right")
        table.add_column("paper", justify="right")
        for sequence in here:
            floors = [r["rmse"] for r in rows if r["kind"] == FLOOR and r["sequence"] == sequence]
            table.add_row(sequence, "the truth's floor", f"{np.mean(floors):.2f}")
            for operator in operators:
                mine = estimates(rows, sequence=sequence, operator=operator, recipe=OURS)
                theirs = estimates(rows, sequence=sequence, operator=operator, recipe=PAPERS)
                ours, low, high, n, of = sequence_rmse(mine, only_solved=True)
                again, *_, m, _ = sequence_rmse(theirs, only_solved=False)
                paper = OXFORD.get(operator, {}).get(sequence)
                table.add_row(
                    "", operator, f"{ours:.2f} ({low:.2f}-{high:.2f})", f"{n}/{of}",
                    f"{ours - paper[0]:+.2f}" if paper else "", f"{paper[0]:g}" if paper else "",
                    f"{again:.2f}", f"{m}/{of}", f"{np.mean([r['matches'] for r in theirs]):,.0f}",
                    f"{paper[1]:,}" if paper else "",
                )  # fmt: skip
        made.append(table)
    made.append(_corner_table(rows, operators))
    made.append(_feature_table(rows))
    return made


def _corner_table(rows: Sequence[Row], operators: Sequence[str]) -> Table:
    table = Table(title="All pairs: corner error", title_justify="left", box=box.SIMPLE_HEAD)
    for column in ("operator", "recipe", "solved in every seed", "wrong, not withheld", "AUC 1 px", "3 px", "5 px", "10 px",
                   "s per pair"):  # fmt: skip
        table.add_column(column, justify="left" if column in ("operator", "recipe") else "right")
    for operator in operators:
        for recipe in (OURS, PAPERS):
            mine = estimates(rows, operator=operator, recipe=recipe)
            pairs = {(r["sequence"], r["pair"]) for r in mine}
            every = sum(all(solved(r) for r in mine if (r["sequence"], r["pair"]) == p) for p in pairs)
            wrong = sum(r["rmse"] is not None and not solved(r) for r in mine)
            errors = [np.inf if r["corner_error_px"] is None else r["corner_error_px"] for r in mine]
            auc = error_auc(errors, (1, 3, 5, 10))
            seconds = float(np.median([r["seconds"] for r in mine]))
            table.add_row(operator, recipe, f"{every}/{len(pairs)}", f"{wrong}/{len(mine)}",
                          *(f"{a:.3f}" for a in auc), f"{seconds:.2f}")  # fmt: skip
    return table


def _feature_table(rows: Sequence[Row]) -> Table:
    table = Table(title="Operators: means over the pairs", title_justify="left", box=box.SIMPLE_HEAD)
    shown = (1, 3, 5, 10)
    for column in ("operator", "keypoints", "matches", "repeatability", "matching score", *(f"MMA {t} px" for t in shown),
                   "s per pair"):  # fmt: skip
        table.add_column(column, justify="left" if column == "operator" else "right")
    mine = [r for r in rows if r["kind"] == "features"]
    for operator in dict.fromkeys(r["operator"] for r in mine):
        r = [row for row in mine if row["operator"] == operator]
        mma = np.mean([row["mma"] for row in r], axis=0)
        table.add_row(
            operator, f"{np.mean([row['keypoints'] for row in r]):,.0f}", f"{np.mean([row['matches'] for row in r]):,.0f}",
            f"{np.mean([row['repeatability'] for row in r]):.3f}", f"{np.mean([row['matching_score'] for row in r]):.3f}",
            *(f"{mma[t - 1]:.3f}" for t in shown), f"{np.mean([row['seconds'] for row in r]):.2f}",
        )  # fmt: skip
    return table


def draw_figures(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Figures 7 to 10, pair by pair on a log axis, our recipe above and the paper's below, as PNG files."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    operators = list(dict.fromkeys(r["operator"] for r in estimates(rows)))
    operators.sort(key=lambda name: name != MULTI)
    colours = dict(zip(operators, plt.rcParams["axes.prop_cycle"].by_key()["color"] * 8))
    files = []
    for number, names in OXFORD_FIGURES.items():
        here = [name for name in names if estimates(rows, sequence=name)]
        if not here:
            continue
        figure, axes = plt.subplots(2, len(here), figsize=(5.5 * len(here), 6.5), sharey="col", squeeze=False)
        for column, sequence in enumerate(here):
            pairs = sorted({r["pair"] for r in estimates(rows, sequence=sequence)})
            for line, (recipe, title) in enumerate(((OURS, "ours"), (PAPERS, "the paper's recipe"))):
                ax = axes[line, column]
                for k, operator in enumerate(operators):
                    mine = estimates(rows, sequence=sequence, operator=operator, recipe=recipe)
                    values = [[r["rmse"] for r in mine if r["pair"] == p and r["rmse"] is not None] for p in pairs]
                    heights = [np.median(v) if v else np.nan for v in values]
                    at = np.arange(len(pairs)) + (k - (len(operators) - 1) / 2) * 0.8 / len(operators)
                    ax.bar(at, heights, 0.8 / len(operators), label=operator, color=colours[operator])
                floors = {r["pair"]: r["rmse"] for r in rows if r["kind"] == FLOOR and r["sequence"] == sequence}
                for x, p in enumerate(pairs):
                    ax.hlines(floors[p], x - 0.45, x + 0.45, colors="black", linestyles="dotted", linewidth=1)
                ax.set(yscale="log", title=f"{sequence}, {title}", ylabel="RMSE of H")
                ax.set_xticks(range(len(pairs)), [f"I{p.replace('-', '')}" for p in pairs])
                ax.grid(axis="y", alpha=0.3)
        axes[0, 0].legend(fontsize=8)
        figure.suptitle(f"Figure {number}: dotted, the truth's floor; no bar, too little evidence", fontsize=10)
        figure.tight_layout()
        file = folder / f"figure{number:02d}.png"
        with atomic_write(file) as temporary:
            figure.savefig(temporary, dpi=110, format="png")
        plt.close(figure)
        files.append(file)
    return files
