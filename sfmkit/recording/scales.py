"""The legend of a recording: names in their colours, and colour bars with numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import rerun as rr
from matplotlib import colormaps

from ..viz.colours import operator_rgb
from .stream import GREY, MAGENTA, put

LEGEND_BOUNDS = ((-2.0, 102.0), (-2.5, 4.5))  # x and y that the view of the legend must contain
BAR_BOUNDS = ((-20.0, 120.0), (-10.0, 22.0))  # the same of a colour bar
SHADES = 64  # segments of a colour bar
CELLS = 40  # cells along the width of an image, in which keypoints are counted
MOST_PER_CELL = 200  # keypoints in a cell that have the last colour; one scale for all operators


def log_legend(rec: rr.RecordingStream, operators: Sequence[str], prefix: str = "") -> None:
    """Log the legend: the name of every operator in its colour, and other marks.

    Class id k of an annotation context stands for ``operators[k]``.
    """
    infos = [rr.AnnotationInfo(k, name, operator_rgb(name)) for k, name in enumerate(operators)]
    put(rec, prefix, "", rr.AnnotationContext(infos))
    names = [*operators, "outlier", "other geometry"]
    colours = [*map(operator_rgb, operators), GREY, MAGENTA]
    # One row of bars, each as wide as its name; the viewer writes the names below.
    ends = np.cumsum([0, *(len(name) + 5 for name in names)])
    ends = 100 * ends / ends[-1]
    bars = [[[a + 1, 0], [b - 1, 0]] for a, b in pairwise(ends)]
    put(rec, prefix, "legend", _bars(bars, colours, labels=names, show_labels=True))


def log_scale(
    rec: rr.RecordingStream, name: str, ticks: Sequence[tuple[float, str]], prefix: str = ""
) -> None:
    """Log the colour bar of a quantity, dark blue to yellow, below ``scale/NAME``.

    Args:
        ticks: positions from 0 to 1 along the bar, with their words.
    """
    x = np.linspace(0, 100, SHADES + 1)
    colours = (colormaps["cividis"](np.linspace(0, 1, SHADES))[:, :3] * 255).astype(np.uint8)
    bars = [[[a, 0], [b, 0]] for a, b in pairwise(x)]
    put(rec, prefix, ["scale", name], _bars(bars, colours, show_labels=False))
    at = [[100 * position, 0] for position, _ in ticks]
    marks = rr.Points2D(
        at, labels=[words for _, words in ticks], show_labels=True, colors=(40, 40, 40), radii=0.3
    )
    put(rec, prefix, ["scale", name, "ticks"], marks)


def percentile_ticks(values: np.ndarray, *, logarithmic: bool) -> list[tuple[float, str]]:
    """Ticks of the colours of :func:`sfmkit.recording.stream.ramp`: 5th to 95th percentile.

    Args:
        values: positive numbers; the colours are those of their logarithms if `logarithmic`.
    """
    shown = np.log(values) if logarithmic else values
    low, high = np.percentile(shown, (5, 95))
    middle = np.array([low, (low + high) / 2, high])
    three = np.exp(middle) if logarithmic else middle
    words = [f"{float(f'{v:.2g}'):,.0f}" if v >= 10 else f"{v:.2g}" for v in three.tolist()]
    return [(0, f"\u2264 {words[0]}"), (0.5, words[1]), (1, f"\u2265 {words[2]}")]


def log_coverage(
    rec: rr.RecordingStream,
    image: int,
    x: np.ndarray,
    size_wh: tuple[int, int],
    operator: str,
    prefix: str = "",
) -> None:
    """Log the number of keypoints per cell as shades over the photograph, and their colour bar.

    Args:
        image: 1 or 2.
        x: (N, 2) pixels.
        size_wh: of the image.
        operator: gives the entity path.
    """
    count = cell_counts(x, size_wh)
    level = np.ceil(np.clip(np.log1p(count) / np.log1p(MOST_PER_CELL), 0, 1) * SHADES)
    colours = (colormaps["cividis"](np.linspace(0, 1, SHADES)) * 255).astype(np.uint8).tolist()
    infos = [rr.AnnotationInfo(k, color=colour) for k, colour in enumerate(colours, start=1)]
    at = [f"world/cam{image}/image/coverage", operator]
    put(rec, prefix, at, rr.AnnotationContext([rr.AnnotationInfo(0, color=(0, 0, 0, 0)), *infos]))
    cell = size_wh[0] / CELLS
    place = rr.Transform3D(translation=[-0.5, -0.5, 0], scale=[cell, cell, 1])
    shades = rr.SegmentationImage(level.astype(np.uint8), opacity=0.7, draw_order=-5)
    put(rec, prefix, at, shades, place, stage="detect")
    ticks = [1, 10, 50, MOST_PER_CELL]
    words = [*(f"{n}" for n in ticks[:-1]), f"\u2265 {MOST_PER_CELL}"]
    positions = (np.log1p(ticks) / np.log1p(MOST_PER_CELL)).tolist()
    log_scale(rec, "coverage", list(zip(positions, words, strict=True)), prefix)


def cell_counts(x: np.ndarray, size_wh: tuple[int, int]) -> np.ndarray:
    """Count pixels (N, 2) in square cells, :data:`CELLS` of them along the width: (rows, CELLS)."""
    w, h = size_wh
    side = w / CELLS
    rows = int(np.ceil(h / side))
    column, row = np.floor((x + 0.5) / side).astype(int).T
    inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < rows)
    count = np.bincount(row[inside] * CELLS + column[inside], minlength=rows * CELLS)
    return count.reshape(rows, CELLS)


def _bars(bars: Sequence[Sequence[Sequence[float]]], colours: object, **look: object) -> object:
    return rr.LineStrips2D(bars, colors=colours, radii=rr.Radius.ui_points(4), **look)  # type: ignore[arg-type]
