"""Picture of the cloud and both cameras along the y axis of camera 1, with a scale."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..types import PointCloud, TwoView

DPI = 130
MOST = 6000  # largest number of points


def scene_from_above(
    cloud: PointCloud, view: TwoView
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Draw the scene in the plane of the x and z axes of camera 1, lengths in baselines.

    Returns:
        (H, W, 3) uint8 picture, and a function that maps (N, 3) points in the frame of camera 1 to
        (N, 2) pixels of the picture.
    """
    X = cloud.xyz.numpy()
    centre2 = np.zeros(3) if view.R is None or view.t is None else -(view.R.T @ view.t).numpy()
    low, high = np.percentile(X, (2, 98), axis=0)
    near = np.flatnonzero(((low <= X) & (high >= X)).all(1))
    near = near[:: max(1, len(near) // MOST)]
    figure = Figure(figsize=(5, 4.4), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    ax.scatter(X[near, 0], X[near, 2], c=cloud.rgb.numpy()[near] / 255, s=3, linewidths=0)
    outward = 1 if centre2[0] > 0 else -1  # the names are on the outer sides of the cameras
    for name, (x, _, z), side in (
        ("camera 1", np.zeros(3), -outward),
        ("camera 2", centre2, outward),
    ):
        ax.plot(x, z, "^", ms=8, color="black")
        ax.annotate(
            name,
            (x, z),
            (8 * side, -4),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
        )
    left, right = min(low[0], centre2[0], 0), max(high[0], centre2[0], 0)
    margin = 0.08 * max(high[2], right - left)
    ax.set(
        xlim=(left - margin, right + margin),
        ylim=(-2 * margin, high[2] + margin),
        aspect="equal",
        xlabel="x (baselines)",
        ylabel="z (baselines)",
        title="along the y axis of camera 1",
    )
    canvas.draw()
    rgb = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    to_display = ax.transData

    def pixels(points: np.ndarray) -> np.ndarray:
        up = to_display.transform(np.asarray(points)[:, [0, 2]])
        return np.column_stack([up[:, 0], rgb.shape[0] - up[:, 1]]) - 0.5

    return rgb, pixels
