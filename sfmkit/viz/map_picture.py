"""Picture of a model: points and cameras from above and from the front."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..types import PointCloud
from .colours import operator_colour

__all__ = ["map_picture"]

_MOST = 60_000  # largest number of points per panel
_MARGIN = 0.05  # margin over the extent of all cameras and the inner 98 % of the points


def map_picture(cloud: PointCloud, centres: np.ndarray, R: np.ndarray, t: np.ndarray) -> Figure:
    """Draw points in the colours of the photographs and of the operators, and the cameras.

    Args:
        cloud: The points.
        centres: (N, 3) projection centres in the frame of the points.
        R, t: (3, 3) and (3,) pose of the camera whose frame is drawn, ``X_camera = R X + t``.
    """
    xyz, cameras = cloud.xyz.numpy() @ R.T + t, centres @ R.T + t
    rows = np.arange(len(xyz))
    if len(rows) > _MOST:
        rows = np.random.default_rng(0).choice(len(rows), _MOST, replace=False)
    main = [cloud.operators[k] for k in cloud.operator_id[rows].tolist()]
    figure = Figure(figsize=(13, 6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _panel(left, xyz[rows], cameras, (0, 2), cloud.rgb[rows].numpy() / 255)
    left.set(title="from above, colours of the photographs", xlabel="x", ylabel="z (forward)")
    _panel(right, xyz[rows], cameras, (0, 1), [operator_colour(name) for name in main])
    right.invert_yaxis()
    right.set(title="from the front, colours of the operators", xlabel="x", ylabel="y (down)")
    _legend(right, [name for name in cloud.operators if name in main])
    return figure


def _panel(
    ax: Axes, xyz: np.ndarray, cameras: np.ndarray, axes: tuple[int, int], colours: Any
) -> None:
    points, shown = xyz[:, axes], cameras[:, axes]
    ax.scatter(points[:, 0], points[:, 1], c=colours, s=1.2, linewidths=0, rasterized=True)
    ax.plot(shown[:, 0], shown[:, 1], "^", color="#D50000", markersize=6, label="cameras")
    ends = np.concatenate([np.percentile(points, (1, 99), axis=0), shown]) if len(points) else shown
    low, high = ends.min(0), ends.max(0)
    margin = _MARGIN * max(float((high - low).max()), 1e-9)
    ax.set_xlim(low[0] - margin, high[0] + margin)
    ax.set_ylim(low[1] - margin, high[1] + margin)
    ax.set_aspect("equal", adjustable="box")


def _legend(ax: Axes, operators: Sequence[str]) -> None:
    handles = [
        Line2D([], [], linestyle="", marker="o", color=operator_colour(name), label=name)
        for name in operators
    ]
    handles.append(Line2D([], [], linestyle="", marker="^", color="#D50000", label="cameras"))
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.12),
        ncols=len(handles),
        frameon=False,
    )
