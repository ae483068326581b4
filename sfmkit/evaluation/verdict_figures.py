"""ROC figure of the benchmark of verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._utils.writing import atomic_write

__all__ = ["Curve", "draw_roc"]

Point = tuple[int, float]

_MARKERS = "o^s"


@dataclass(frozen=True)
class Curve:
    """The ROC curve of a method.

    Attributes:
        name: Name of the method.
        points: Number of accepted wrong poses, and share of the solved pairs that are accepted with
            the right pose, from strict to lenient acceptance.
        marks: Label and point of each rule of the method.
    """

    name: str
    points: tuple[Point, ...]
    marks: tuple[tuple[str, Point], ...]


def draw_roc(path: Path, curves: Sequence[Curve]) -> None:
    """Draw right poses over wrong poses as PNG.

    The axis is logarithmic above ten wrong poses. Each label of a mark has its own symbol.
    """
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    ax = figure.subplots()
    ax.set_xscale("symlog", linthresh=10)
    markers: dict[str, str] = {}
    for k, curve in enumerate(curves):
        x, y = zip(*curve.points)
        ax.plot(x, y, color=f"C{k}", label=curve.name, drawstyle="steps-post", zorder=3 - k / 10)
        for label, point in curve.marks:
            marker = markers.setdefault(label, _MARKERS[len(markers) % len(_MARKERS)])
            ax.plot(*point, marker, color=f"C{k}", markersize=7, zorder=4)
    for label, marker in markers.items():
        ax.plot([], [], marker, color="grey", markersize=7, label=label)
    ax.set_xlim(left=-0.4)
    ax.set_ylim(0, 1.02)
    ax.set_xlabel("wrong poses accepted (number of pairs)")
    ax.set_ylabel("solved pairs accepted with the right pose")
    ax.grid(alpha=0.3)
    ax.legend(loc="lower right")
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
