"""Pictures of a result with matplotlib, drawn off screen: no display is needed and no global state is touched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..pipeline import Reconstruction
from ..types import PointCloud
from .colours import operator_colour

MAX_LINES = 400  # more lines hide one another


def _save(figure: Figure, path: Path, dpi: int = 110) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=dpi)


def save_match_picture(path: str | Path, result: Reconstruction, max_lines: int = MAX_LINES, seed: int = 0) -> None:
    """Both photographs side by side with an even sample of the inliers, coloured by operator, outliers thin and grey."""
    corr, inliers = result.correspondences, result.two_view.inliers.numpy()
    (w1, h1), (w2, h2) = result.images[0].size_wh, result.images[1].size_wh
    gap = round(0.01 * (w1 + w2))
    scale = max(1, round((w1 + w2) / 3000))  # a picture of about 3000 pixels is enough for a page
    figure = Figure(figsize=(14, 14 * max(h1, h2) / (w1 + w2 + gap) + 0.9), layout="constrained")
    ax = figure.add_subplot()
    ax.imshow(result.images[0].rgb[::scale, ::scale], extent=(-0.5, w1 - 0.5, h1 - 0.5, -0.5))
    ax.imshow(result.images[1].rgb[::scale, ::scale], extent=(w1 + gap - 0.5, w1 + gap + w2 - 0.5, h2 - 0.5, -0.5))
    x1, x2 = corr.x1.numpy(), corr.x2.numpy() + [w1 + gap, 0]
    rng = np.random.default_rng(seed)
    handles = []
    out = rng.permutation(np.flatnonzero(~inliers))[: max_lines // 4]
    ax.add_collection(LineCollection(np.stack([x1[out], x2[out]], 1), colors="#808080", linewidths=0.3, alpha=0.6))
    for k, name in enumerate(corr.operators):
        mine = np.flatnonzero(inliers & (corr.operator_id.numpy() == k))
        some = rng.permutation(mine)[: max_lines // len(corr.operators)]
        colour = operator_colour(name)
        ax.add_collection(LineCollection(np.stack([x1[some], x2[some]], 1), colors=colour, linewidths=0.6, alpha=0.8))
        both = np.concatenate([x1[some], x2[some]])
        ax.scatter(both[:, 0], both[:, 1], s=3, color=colour, linewidths=0)
        handles.append(Line2D([], [], color=colour, label=f"{name}: {len(some):,} of {len(mine):,} inliers"))
    handles.append(Line2D([], [], color="#808080", lw=0.5, label=f"{len(out):,} of {int((~inliers).sum()):,} outliers"))
    ax.set(xlim=(-0.5, w1 + gap + w2 - 0.5), ylim=(max(h1, h2) - 0.5, -0.5), ylabel="y (pixels)",
           xlabel="x (pixels; image 2 shifted to the right)")  # fmt: skip
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    _save(figure, Path(path))


def save_cloud_picture(path: str | Path, cloud: PointCloud) -> None:
    """The cloud from camera 1's side and from above, in its colours, and coloured by operator; units of the baseline."""
    X = cloud.xyz.numpy()
    lo, hi = np.percentile(X, (1, 99), axis=0)
    pad = 0.05 * (hi - lo) + 1e-9
    near = ((lo - pad <= X) & (hi + pad >= X)).all(1)
    X, rgb = X[near], cloud.rgb.numpy()[near] / 255
    size = float(np.clip(20_000 / max(len(X), 1), 0.3, 6))
    by_operator = np.array([operator_colour(name) for name in cloud.operators])[cloud.operator_id.numpy()[near]]
    far_first = np.argsort(-X[:, 2])
    from_above = np.argsort(X[:, 1])[::-1]
    figure = Figure(figsize=(14, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, (order, i, j, title) in enumerate(((far_first, 0, 1, "from camera 1"), (from_above, 0, 2, "from above"))):
        for column, (colour, what) in enumerate(((rgb, "photograph"), (by_operator, "operator"))):
            ax = axes[row, column]
            ax.scatter(X[order, i], X[order, j], c=colour[order], s=size, linewidths=0)
            ax.set(
                aspect="equal",
                xlabel="x (baselines)",
                ylabel=f"{'xyz'[j]} (baselines)",
                title=f"{title}, colour: {what}",
            )
            if j == 1:
                ax.invert_yaxis()
    handles = [
        Line2D(
            [], [], marker="o", ls="", color=operator_colour(name), label=f"{name}: {int(cloud.found_by(name).sum()):,}"
        )
        for name in cloud.operators
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    _save(figure, Path(path))
