"""Picture of the pairs of a folder: a graph of the photographs, and a matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..types import Verdict

__all__ = ["VERDICT_COLOURS", "pair_graph"]

# Palette of Okabe and Ito, see sfmkit.viz.colours.
VERDICT_COLOURS = {
    Verdict.GENERAL.value: "#0072B2",
    Verdict.PLANAR.value: "#009E73",
    Verdict.PURE_ROTATION.value: "#E69F00",
    Verdict.AMBIGUOUS.value: "#CC79A7",
    Verdict.TOO_LITTLE.value: "#BBBBBB",
    "failed": "#D55E00",
}
_LABELS = 40  # largest number of photographs with legible names
_LONGEST = 18  # largest number of characters of a name
_WIDEST = 4.0  # width of the line with the most inliers, points


def pair_graph(
    names: Sequence[str],
    pairs: np.ndarray,
    verdicts: Sequence[str],
    inliers: np.ndarray,
    positions: np.ndarray | None = None,
) -> Figure:
    """Draw photographs as dots and pairs as lines, and the inliers of every pair as a matrix.

    A line has the colour of the verdict and a width that grows with the inliers. Pairs without a
    geometry are thin and grey.

    Args:
        names: N names of photographs.
        pairs: (P, 2) indices of photographs.
        verdicts: P verdicts.
        inliers: (P,) numbers of inliers.
        positions: (N, 2) metres east and north. If it is None or contains NaN, the photographs are
            drawn on a circle in their order.
    """
    n = len(names)
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    graph, matrix = figure.subplots(1, 2)
    located = positions is not None and bool(np.isfinite(positions).all()) and np.ptp(positions) > 0
    if located and positions is not None:
        xy = positions
        graph.set(xlabel="east (m)", ylabel="north (m)", title="pairs at the GPS positions")
    else:
        angle = np.pi / 2 - 2 * np.pi * np.arange(n) / n
        xy = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        graph.set_axis_off()
        graph.set_title("pairs, photographs clockwise in the order of their names")
    _draw_lines(graph, xy, pairs, verdicts, inliers)
    graph.plot(*xy.T, "o", color="#202020", markersize=4, zorder=3)
    if n <= _LABELS:
        _draw_names(graph, xy, names, located)
    graph.set_aspect("equal", adjustable="datalim")
    graph.margins(0.12 if located else 0.35)
    _draw_matrix(figure, matrix, names, pairs, inliers)
    return figure


def _draw_lines(
    ax: Axes, xy: np.ndarray, pairs: np.ndarray, verdicts: Sequence[str], inliers: np.ndarray
) -> None:
    most = max(float(inliers.max(initial=0)), 1.0)
    handles = []
    for verdict, colour in reversed(VERDICT_COLOURS.items()):  # general pairs on top
        rows = np.array([v == verdict for v in verdicts], dtype=bool)
        if not rows.any():
            continue
        widths = 0.4 + (_WIDEST - 0.4) * np.sqrt(inliers[rows] / most)
        if verdict == Verdict.TOO_LITTLE.value:
            widths = np.full(rows.sum(), 0.4)
        ax.add_collection(LineCollection(xy[pairs[rows]], colors=colour, linewidths=widths))
        label = f"{verdict}: {rows.sum():,}"
        handles.append(Line2D([], [], color=colour, linewidth=3, label=label))
    ax.legend(
        handles=handles[::-1],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=len(handles),
        frameon=False,
        fontsize=9,
    )


def _draw_names(ax: Axes, xy: np.ndarray, names: Sequence[str], located: bool) -> None:
    for (x, y), name in zip(xy, names):
        text = name if len(name) <= _LONGEST else f"...{name[3 - _LONGEST :]}"
        if located:
            ax.annotate(text, (x, y), xytext=(5, 5), textcoords="offset points", fontsize=8)
            continue
        turn = float(np.degrees(np.arctan2(y, x)))
        left = abs(turn) > 90
        ax.text(
            1.05 * x,
            1.05 * y,
            text,
            rotation=turn + 180 if left else turn,
            rotation_mode="anchor",
            ha="right" if left else "left",
            va="center",
            fontsize=8,
        )


def _draw_matrix(
    figure: Figure, ax: Axes, names: Sequence[str], pairs: np.ndarray, inliers: np.ndarray
) -> None:
    n = len(names)
    values = np.full((n, n), np.nan)
    i, j = pairs.T
    values[i, j] = values[j, i] = np.maximum(inliers, 1)
    top = max(float(inliers.max(initial=1)), 10.0)
    shown = ax.imshow(values, cmap="cividis", norm=LogNorm(1, top), interpolation="nearest")
    ax.set_title("inliers of every matched pair (white: not matched)")
    if n > _LABELS:
        ax.set(xlabel="photograph", ylabel="photograph")
    else:
        ticks = [name if len(name) <= _LONGEST else f"...{name[3 - _LONGEST :]}" for name in names]
        ax.set_xticks(range(n), ticks, rotation=90, fontsize=8)
        ax.set_yticks(range(n), ticks, fontsize=8)
    figure.colorbar(shown, ax=ax, label="inliers", shrink=0.8)
