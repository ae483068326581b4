"""Figure 11 of the paper: clouds of single operators and of all operators together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._utils.writing import atomic_write
from ..pipeline.account import ALL
from ..types import Camera, PointCloud
from ..viz.splats import splat

_ORDER = ("fast-brief", "orb", "surf")  # order of the paper; others follow
_DOT = 3  # size of a point, pixels


def draw_clouds(path: Path, clouds: Mapping[str, PointCloud], camera: Camera) -> None:
    """Draw every cloud from the viewpoint of camera 1, two per row, as PNG."""
    names = sorted(
        clouds, key=lambda n: (n == ALL, _ORDER.index(n) if n in _ORDER else len(_ORDER))
    )
    lines = max(1, (len(names) + 1) // 2)
    ratio = camera.size_wh[1] / camera.size_wh[0]
    figure = Figure(figsize=(12, lines * (6 * ratio + 0.3)), layout="constrained")
    axes = figure.subplots(lines, 2, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, name in zip(axes, names):
        ax.imshow(splat(clouds[name], camera, width=800, dot=_DOT), interpolation="none")
        ax.set_title(
            f"{'all together' if name == ALL else name}: {len(clouds[name]):,} points", fontsize=11
        )
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
