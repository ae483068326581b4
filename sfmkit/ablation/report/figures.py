"""The plots of an ablation's report. Whiskers are 95 % intervals; operators have
colours, combinations are grey."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from ...reports.result import ResultFigure
from ...viz.colours import operator_colour
from .contributions import Contributions
from .findings import Findings
from .intervals import Interval
from .ranks import Ranking
from .scores import Setup
from .tables import slug

INK, SOFT = "#333333", "#999999"
MANY = "#555555"
WIDTH = 7  # inches
# In addition to the colours, for readers who cannot distinguish these; others are pentagons.
_MARKERS = {
    "surf": "o",
    "orb": "s",
    "fast-brief": "D",
    "sift": "^",
    "akaze": "v",
    "kaze": "P",
    "brisk": "X",
}


def figures(f: Findings, folder: Path) -> list[ResultFigure]:
    """Draw the plots of one data set into `folder`."""
    name, s = slug(f.scores.dataset), f.scores
    unit = s.measure.show(s.measure.main)
    drawn = [
        _save(
            auc_figure(f),
            folder,
            f"{name}-auc.png",
            f"{s.dataset}: area under the curve up to {unit}",
            f"A dot with its 95 % interval for every setup, best first: {s.label(f.best)} leads",
        )
    ]
    if np.isfinite(f.seconds.value).any() and len(s.setups) > 1:
        front = ", ".join(s.label(c) for c in map(int, np.flatnonzero(f.front)))
        drawn.append(
            _save(
                pareto_figure(f),
                folder,
                f"{name}-time.png",
                f"{s.dataset}: error against time",
                f"Mean error cut at {unit} over seconds a pair; on the front are {front}",
            )
        )
    for c in f.contributions:
        which = f"-{slug(c.variant)}" if s.several else ""
        drawn.append(
            _save(
                contribution_figure(c, unit),
                folder,
                f"{name}-contributions{which}.png",
                f"{s.dataset}{f', {c.variant}' if s.several else ''}: contributions",
                "For every operator: its AUC alone, the loss without it, and its Shapley value, "
                "with 95 % intervals",
            )
        )
    if f.ranking is not None:
        drawn.append(draw_ranking(s.dataset, s.labels, s.setups, f.ranking, folder))
    return drawn


def draw_ranking(
    dataset: str, labels: Sequence[str], setups: Sequence[Setup], ranking: Ranking, folder: Path
) -> ResultFigure:
    return _save(
        ranking_figure(labels, setups, ranking),
        folder,
        f"{slug(dataset)}-ranking.png",
        f"{dataset}: average ranks and critical difference",
        "A dot at every setup's average rank, best first, with bars "
        f"{ranking.critical_difference:.2f} long: the critical difference",
    )


def auc_figure(f: Findings) -> Figure:
    """Draw the setups with their AUC at the main threshold, best first."""
    s = f.scores
    figure = Figure(figsize=(WIDTH, 1.2 + 0.24 * len(s.setups)), layout="constrained")
    ax = figure.add_subplot()
    interval = f.auc[s.measure.main]
    for y, c in enumerate(f.order):
        _whisker(ax, interval.at(c), y, s.setups[c])
    _rows(ax, [s.label(c) for c in f.order])
    ax.set(
        xlabel=(
            f"area under the curve up to {s.measure.show(s.measure.main)} (1: no error); "
            "whiskers: 95 % interval"
        )
    )
    return figure


def pareto_figure(f: Findings) -> Figure:
    """Draw the error, clipped at the main threshold, over the seconds per pair, and the front."""
    s, main, unit = f.scores, f.scores.measure.main, f.scores.measure.unit
    auc, time = f.auc[main], f.seconds
    error = Interval(
        *(main * (1 - a) for a in (auc.value, auc.high, auc.low))
    )  # mean of min(error, main)
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    ax = figure.add_subplot()
    known = [int(c) for c in np.flatnonzero(np.isfinite(time.value))]
    for c in known:
        x, y, setup = time.at(c), error.at(c), s.setups[c]
        colour, marker = _look(setup)
        for values, other, line in ((x, y[0], ax.hlines), (y, x[0], ax.vlines)):
            if np.isfinite(values[1:]).all():
                line(other, values[1], values[2], colors=colour, linewidths=0.8, alpha=0.35)
        ax.plot(x[0], y[0], marker, color=colour, ms=7 if len(setup.operators) == 1 else 5)
    front = sorted(map(int, np.flatnonzero(f.front)), key=lambda c: float(time.value[c]))
    ax.step(time.value[front], error.value[front], where="post", color=INK, lw=1, ls="--", zorder=0)
    middle = np.sqrt(time.value[known].min() * time.value[known].max())
    for place, c in enumerate(front):
        right = time.value[c] > middle
        ax.annotate(
            s.label(c),
            (time.value[c], error.value[c]),
            (-6 if right else 6, 7 if place % 2 else -11),
            textcoords="offset points",
            fontsize=8,
            ha="right" if right else "left",
            bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.5},
        )
    shown = dict.fromkeys(s.setups[c] if len(s.setups[c].operators) == 1 else None for c in known)
    handles = [
        Line2D([], [], ls="", color=colour, marker=marker, label=setup.combination)
        for setup in shown
        if setup is not None
        for colour, marker in [_look(setup)]
    ]
    handles += [
        Line2D([], [], ls="", color=c, marker="o", ms=4, label=n)
        for c, n in ((SOFT, "two"), (MANY, "more"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    ax.set(
        xscale="log",
        yscale="log" if (error.value[known] > 0).all() else "linear",
        xlabel="time on one core (s per pair)",
        ylabel=f"mean error, cut at {s.measure.show(main)} ({unit})",
        title="dashed: no other is both faster and better",
    )
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        digits = "23456789" if high < 8 * low else "235"
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axis.set_minor_formatter(
            FuncFormatter(lambda v, _, digits=digits: f"{v:.2g}" if f"{v:e}"[0] in digits else "")
        )
        axis.set_tick_params(which="both", labelsize=9)
    ax.grid(alpha=0.25)
    return figure


def contribution_figure(c: Contributions, unit: str) -> Figure:
    """Draw the quality alone, the loss without, and the Shapley value of every operator."""
    parts = [("alone", c.alone), ("loss without it", c.without), ("Shapley value", c.shapley)]
    shown = [(title, interval) for title, interval in parts if interval is not None]
    figure = Figure(figsize=(WIDTH, 1.3 + 0.32 * len(c.operators)), layout="constrained")
    for ax, (title, interval) in zip(
        figure.subplots(1, max(len(shown), 1), sharey=True, squeeze=False)[0], shown
    ):
        for y, operator in enumerate(c.operators):
            _whisker(ax, interval.at(y), y, Setup((operator,), ""))
        if title != "alone":
            ax.axvline(0, color=SOFT, lw=1, zorder=0)
        ax.set_title(title, fontsize=10)
        ax.set_xlabel(f"AUC {unit}")
        _rows(ax, list(c.operators))
    return figure


def ranking_figure(labels: Sequence[str], setups: Sequence[Setup], r: Ranking) -> Figure:
    """Draw a critical-difference diagram: one row per setup, with bars of half the difference."""
    figure = Figure(figsize=(WIDTH, 1.3 + 0.24 * len(labels)), layout="constrained")
    ax = figure.add_subplot()
    half = r.critical_difference / 2
    for y, c in enumerate(r.order):
        _whisker(ax, (r.average[c], r.average[c] - half, r.average[c] + half), y, setups[c])
    _rows(ax, [labels[c] for c in r.order])
    ax.set(
        xlabel=f"average rank over {r.blocks} {r.unit}s (1: best on all of them)",
        xlim=(1 - half - 0.3, None),
    )
    ax.set_title("bars that overlap: no significant difference", fontsize=10)
    return figure


def _look(setup: Setup) -> tuple[str, str]:
    """Return colour and marker; single operators have their own, combinations are grey."""
    if len(setup.operators) > 1:
        return SOFT if len(setup.operators) == 2 else MANY, "."
    return operator_colour(setup.operators[0]), _MARKERS.get(setup.operators[0], "p")


def _whisker(ax, values: tuple[float, float, float], y: float, setup: Setup) -> None:
    value, low, high = values
    colour, marker = _look(setup)
    if np.isfinite([low, high]).all():
        ax.hlines(y, low, high, colors=colour, linewidths=1.6)
    ax.plot(value, y, marker, color=colour, ms=6 if marker != "." else 8)


def _rows(ax, labels: list[str]) -> None:
    """Label the rows from the top."""
    ax.set_yticks(range(len(labels)), labels, fontsize=8)
    ax.set_ylim(len(labels) - 0.4, -0.6)
    ax.grid(axis="x", alpha=0.25)
    ax.grid(axis="y", alpha=0.12)


def _save(figure: Figure, folder: Path, file: str, title: str, alt: str) -> ResultFigure:
    FigureCanvasAgg(figure)
    figure.savefig(folder / file, dpi=120)
    return ResultFigure(title, file, alt)
