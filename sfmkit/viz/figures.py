"""Figures of photographs, features, matches and clouds, with labelled axes, in the operators'
colours.

Each function returns a matplotlib Figure, which a notebook shows and :func:`save` writes: no
display is needed and no global state is touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..types import Features, PointCloud
from .colours import operator_colour

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

GREY = "#808080"
MAX_DOTS = 200_000  # points of a cloud that a picture can show


def photographs(
    *images: Any, titles: Sequence[str] = (), height: float = 4.0
) -> tuple[Figure, list[Axes]]:
    """Photographs side by side, axes in pixels.

    Args:
        images: :class:`sfmkit.io.images.Image`, or (H, W) or (H, W, 3) arrays.
    """
    arrays = [getattr(image, "rgb", image) for image in images]
    width = sum(a.shape[1] / a.shape[0] for a in arrays) * height
    figure = Figure(figsize=(width + 0.6, height + 0.6), layout="constrained")
    axes = list(figure.subplots(1, len(arrays), squeeze=False)[0])
    for k, (ax, a) in enumerate(zip(axes, arrays)):
        ax.imshow(a, cmap="gray", vmin=0, vmax=255)
        ax.set(xlabel="x (pixels)", ylabel="y (pixels)" if k == 0 else "", autoscale_on=False)
        if k < len(titles):
            ax.set_title(titles[k])
    return figure, axes


def feature_figure(image: Any, *features: Features, most: int = 300) -> Figure:
    """The strongest keypoints on the photograph: a circle is the described neighbourhood, a tick
    its orientation.

    Args:
        features: one or several operators' features of this image.
        most: at most this many of each.
    """
    figure, (ax,) = photographs(image, height=5)
    handles = []
    for f in features:
        some = f.take(np.argsort(-f.scores, kind="stable")[:most])
        colour = operator_colour(f.operator)
        d = some.scales
        ax.add_collection(
            EllipseCollection(
                d,
                d,
                np.zeros(len(d)),
                units="xy",
                offsets=some.keypoints,
                offset_transform=ax.transData,
                facecolors="none",
                edgecolors=colour,
                linewidths=0.7,
            )
        )
        tip = some.keypoints + d[:, None] / 2 * np.column_stack(
            [np.cos(some.angles), np.sin(some.angles)]
        )
        if some.angles.any():
            ax.add_collection(
                LineCollection(np.stack([some.keypoints, tip], 1), colors=colour, linewidths=0.7)
            )
        label = f"{f.operator}: {len(some):,} strongest of {len(f):,}"
        handles.append(Line2D([], [], marker="o", ls="", mfc="none", color=colour, label=label))
    figure.legend(
        handles=handles, loc="outside upper center", ncols=max(1, len(handles)), frameon=False
    )
    return figure


def match_figure(
    image1: Any,
    image2: Any,
    x1: Any,
    x2: Any,
    right: Any | None = None,
    *,
    operator: str = "multi",
    most: int = 120,
) -> Figure:
    """Matches as lines between two photographs.

    Args:
        x1, x2: (N, 2) pixels.
        right: (N,) bool; those that are not are drawn grey and dashed.
        operator: whose colour to use.
        most: an even sample of this many is drawn.
    """
    figure, ax, shift = _side_by_side(image1, image2)
    a, b = np.asarray(x1), np.asarray(x2) + [shift, 0]
    good = np.ones(len(a), dtype=bool) if right is None else np.asarray(right)
    rows = np.random.default_rng(0).permutation(len(a))[:most]
    for some, colour, style in (
        (rows[~good[rows]], GREY, "--"),
        (rows[good[rows]], operator_colour(operator), "-"),
    ):
        _lines(ax, a[some], b[some], colors=colour, linewidths=0.8, linestyles=style)
    share = "" if right is None or not len(a) else f", {good.mean():.0%} of all right"
    ax.set_title(f"{len(rows):,} of {len(a):,} matches{share}")
    return figure


def match_picture(result: Reconstruction, most: int = 400) -> Figure:
    """The matches of a reconstruction: an even sample of each operator's inliers in its colour, and
    of the outliers in grey.

    Args:
        most: lines in all; more would hide one another.
    """
    corr, inliers = result.correspondences, result.two_view.inliers.numpy()
    figure, ax, shift = _side_by_side(*result.images)
    a, b = corr.x1.numpy(), corr.x2.numpy() + [shift, 0]
    rng = np.random.default_rng(0)
    out = rng.permutation(np.flatnonzero(~inliers))[: most // 4]
    _lines(ax, a[out], b[out], colors=GREY, linewidths=0.3, alpha=0.6)
    handles = []
    for k, name in enumerate(corr.operators):
        mine = np.flatnonzero(inliers & (corr.operator_id.numpy() == k))
        some = rng.permutation(mine)[: most // len(corr.operators)]
        colour = operator_colour(name)
        _lines(ax, a[some], b[some], colors=colour, linewidths=0.6, alpha=0.8)
        x, y = np.concatenate([a[some], b[some]]).T
        ax.scatter(x, y, s=3, color=colour, linewidths=0)
        handles.append(
            Line2D([], [], color=colour, label=f"{name}: {len(some):,} of {len(mine):,} inliers")
        )
    handles.append(
        Line2D(
            [], [], color=GREY, lw=0.5, label=f"{len(out):,} of {int((~inliers).sum()):,} outliers"
        )
    )
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure


def _side_by_side(image1: Any, image2: Any) -> tuple[Figure, Axes, int]:
    """A figure with two photographs, its axes in pixels of the first, and where on them the second
    begins."""
    first, second = (getattr(image, "rgb", image) for image in (image1, image2))
    (h1, w1), (h2, w2) = first.shape[:2], second.shape[:2]
    shift = round(1.02 * w1)
    thin = max(1, round((w1 + w2) / 3000))  # a page shows no more pixels
    figure = Figure(figsize=(13, 13 * max(h1, h2) / (shift + w2) + 0.8), layout="constrained")
    ax = figure.add_subplot()
    for pixels, x0, w, h in ((first, 0, w1, h1), (second, shift, w2, h2)):
        extent = (x0 - 0.5, x0 + w - 0.5, h - 0.5, -0.5)
        ax.imshow(pixels[::thin, ::thin], cmap="gray", vmin=0, vmax=255, extent=extent)
    ax.set(
        xlim=(-0.5, shift + w2 - 0.5),
        ylim=(max(h1, h2) - 0.5, -0.5),
        ylabel="y (pixels)",
        xlabel=f"x (pixels; image 2 begins at {shift})",
    )
    return figure, ax, shift


def _lines(ax: Axes, a: np.ndarray, b: np.ndarray, **style: Any) -> None:
    ax.add_collection(LineCollection(np.stack([a, b], 1), **style))


def epipolar_figure(
    image1: Any, image2: Any, x1: Any, lines2: Any, x2: Any | None = None, lines1: Any | None = None
) -> Figure:
    """Points of image 1 and their epipolar lines in image 2, in matching colours.

    Args:
        x1: (N, 2) pixels of image 1.
        lines2: (N, 3) lines in image 2, ``a x + b y + c = 0``.
        x2: (N, 2) the matches in image 2.
        lines1: (N, 3) lines in image 1, of x2.
    """
    figure, axes = photographs(image1, image2, titles=("image 1", "image 2: the epipolar lines"))
    colours = [f"C{k % 10}" for k in range(len(x1))]
    for ax, points, lines in ((axes[0], x1, lines1), (axes[1], x2, lines2)):
        if lines is not None:
            for (a, b, c), colour in zip(np.asarray(lines), colours):
                foot = -c * np.array([a, b]) / (a * a + b * b)
                ax.axline(foot, foot + [b, -a], color=colour, lw=1)
        if points is not None:
            x, y = np.asarray(points).T
            ax.scatter(x, y, c=colours, s=28, edgecolors="white", linewidths=0.8, zorder=3)
    return figure


def unit_of(cloud: PointCloud) -> str:
    """The unit of a cloud's lengths to write after a number: baselines in ours, in others what
    nobody tells us."""
    return " baselines" if cloud.operators else ""


def cloud_figure(
    cloud: PointCloud, *, colour: Any | None = None, label: str = "", cameras: Any | None = None
) -> Figure:
    """The cloud from camera 1's side and from above; a foreign one, whose frame is not known, along
    z and along y.

    Of a large cloud at most 200,000 points are drawn, and none beyond the inner 98 % in any
    direction.

    Args:
        colour: (M,) numbers to colour the points by, None for the photograph's colours.
        label: what the numbers are, with their unit.
        cameras: (2, 3) centres of the cameras, drawn from above.
    """
    near = _shown(cloud)
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    axes = figure.subplots(1, 2)
    shades = cloud.rgb.numpy()[near] / 255 if colour is None else np.asarray(colour)[near]
    dots = _two_sides(axes, cloud, near, shades, "cividis")
    if cameras is not None:
        for number, (x, _, z) in enumerate(np.asarray(cameras), start=1):
            axes[1].plot(x, z, "^", ms=8, color="black")
            axes[1].annotate(f"camera {number}", (x, z), (6, 4), textcoords="offset points")
    if colour is not None:
        figure.colorbar(dots, ax=axes, label=label)
    return figure


def cloud_picture(cloud: PointCloud) -> Figure:
    """The same two sides twice: in the photograph's colours, and in those of the operators."""
    near = _shown(cloud)
    figure = Figure(figsize=(14, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    operators = np.array([operator_colour(name) for name in cloud.operators])
    for row, shades, what in zip(
        axes,
        (cloud.rgb.numpy()[near] / 255, operators[cloud.operator_id.numpy()[near]]),
        ("photograph", "operator"),
    ):
        _two_sides(row, cloud, near, shades)
        for ax in row:
            ax.set_title(f"{ax.get_title()}, colour: {what}")
    handles = [
        Line2D(
            [],
            [],
            marker="o",
            ls="",
            color=colour,
            label=f"{name}: {int(cloud.found_by(name).sum()):,}",
        )
        for name, colour in zip(cloud.operators, operators)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def _shown(cloud: PointCloud) -> np.ndarray:
    """The rows of a cloud that a picture shows."""
    X = cloud.xyz.numpy()
    if len(X) <= 2:
        return np.arange(len(X))
    low, high = np.percentile(X, (1, 99), axis=0)
    near = np.flatnonzero(((low <= X) & (high >= X)).all(1))
    return near[:: max(1, -(-len(near) // MAX_DOTS))]


def _two_sides(
    axes: Sequence[Axes],
    cloud: PointCloud,
    near: np.ndarray,
    shades: np.ndarray,
    cmap: str | None = None,
) -> PathCollection:
    """Some points of a cloud from camera 1 and from above, on two axes."""
    X = cloud.xyz.numpy()[near]
    ours = bool(cloud.operators)
    unit = f" ({unit_of(cloud).strip()})" if ours else ""
    size = float(np.clip(40_000 / max(len(X), 1), 0.5, 4))
    for ax, j, title in zip(
        axes, (1, 2), ("from camera 1", "from above") if ours else ("along z", "along y")
    ):
        order = np.argsort(-X[:, 2] if j == 1 else -X[:, 1])  # the nearest last, on top
        dots = ax.scatter(
            X[order, 0],
            X[order, j],
            c=shades[order],
            s=size,
            linewidths=0,
            cmap=cmap if shades.ndim == 1 else None,
        )
        ax.set(aspect="equal", xlabel=f"x{unit}", ylabel=f"{'xyz'[j]}{unit}", title=title)
        if j == 1 and ours:
            ax.invert_yaxis()
    return dots


def save(figure: Figure, path: str | Path, dpi: int = 110) -> None:
    """Write a figure as a picture, off screen."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=dpi)
