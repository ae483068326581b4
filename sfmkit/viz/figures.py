"""Figures of photographs, features, matches and clouds, in the colours of the operators.

Each function returns a matplotlib Figure. A notebook displays it, and :func:`save` writes it to a
file. The functions need no display and do not change global state.
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
from matplotlib.patheffects import withStroke

from ..types import Features, PointCloud
from .colours import operator_colour
from .sampling import spread_strongest

if TYPE_CHECKING:
    from ..pipeline.reconstruction import Reconstruction

# Lines on photographs have a dark edge, so that they are visible on bright and dark backgrounds.
CASING = "#202020"
MATCH = "#F0E442"  # matches without an operator
OUTLIER = "#F5F5F5"
MAX_DOTS = 200_000  # largest number of points in a picture


def photographs(
    *images: Any, titles: Sequence[str] = (), height: float = 4.0
) -> tuple[Figure, list[Axes]]:
    """Show photographs side by side, with axes in pixels.

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
    """Draw strong keypoints, spread over the photograph, with scale and orientation.

    A circle shows the described neighbourhood, a tick its orientation. The strongest keypoints of
    each cell of a grid are drawn, because the strongest ones of the image are often concentrated in
    a few regions.

    Args:
        image: The photograph.
        features: Features of this image, of one or several operators.
        most: Largest number of keypoints per operator.
    """
    figure, (ax,) = photographs(image, height=5)
    handles = []
    for f in features:
        some = f.take(spread_strongest(f.keypoints, f.scores, most))
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
                linewidths=1.1,
                path_effects=_casing(1.1),
            )
        )
        tip = some.keypoints + d[:, None] / 2 * np.column_stack(
            [np.cos(some.angles), np.sin(some.angles)]
        )
        if some.angles.any():
            ax.add_collection(
                LineCollection(np.stack([some.keypoints, tip], 1), colors=colour, linewidths=1.1)
            )
        label = f"{f.operator}: {len(some):,} of {len(f):,}, the strongest of each region"
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
    operator: str | None = None,
    most: int = 120,
    meaning: str = "agree with the geometry",
) -> Figure:
    """Draw matches as lines between two photographs.

    Args:
        x1, x2: (N, 2) pixels.
        right: (N,) bool; the other matches are drawn white and dashed.
        operator: Name of the operator, which determines the colour; yellow without it.
        most: Largest number of matches, a random sample.
        meaning: Meaning of `right` for the title.
    """
    figure, ax, shift = _side_by_side(image1, image2)
    a, b = np.asarray(x1), np.asarray(x2) + [shift, 0]
    good = np.ones(len(a), dtype=bool) if right is None else np.asarray(right)
    rows = np.random.default_rng(0).permutation(len(a))[:most]
    colour = MATCH if operator is None else operator_colour(operator)
    _lines(ax, a, b, rows[~good[rows]], OUTLIER, linestyles="--")
    _lines(ax, a, b, rows[good[rows]], colour)
    share = "" if right is None or not len(a) else f"; {good.mean():.0%} of all {meaning}"
    ax.set_title(f"{len(rows):,} of {len(a):,} matches shown{share}")
    return figure


def match_picture(result: Reconstruction, most: int = 140) -> Figure:
    """Draw a sample of the inliers of a reconstruction by operator, and of the outliers.

    The counts are those of the per-operator statistics: a match found by several operators counts
    for each of them. Its line has the colour of the operator whose pixels were kept.

    Args:
        result: A reconstruction.
        most: Largest number of lines; more would cover each other.
    """
    corr, inliers = result.correspondences, result.two_view.inliers.numpy()
    figure, ax, shift = _side_by_side(*result.images)
    a, b = corr.x1.numpy(), corr.x2.numpy() + [shift, 0]
    rng = np.random.default_rng(0)
    outliers = np.flatnonzero(~inliers)
    # Proportional to their share, so that the picture shows the share of rejected matches.
    drawn = rng.permutation(outliers)[: round(most * len(outliers) / max(len(inliers), 1))]
    _lines(ax, a, b, drawn, OUTLIER, linestyles="--")
    handles = []
    for k, name in enumerate(corr.operators):
        mine = np.flatnonzero(inliers & (corr.operator_id.numpy() == k))
        colour, share = operator_colour(name), len(mine) / max(len(inliers), 1)
        some = rng.permutation(mine)[: int(np.ceil(most * share))]
        _lines(ax, a, b, some, colour)
        label = f"{name}: {result.account[name].inliers:,} inliers"
        handles.append(Line2D([], [], color=colour, lw=2, label=label))
    edge = [withStroke(linewidth=2.5, foreground=CASING)]
    label = f"{len(outliers):,} outliers"
    handles.append(Line2D([], [], color=OUTLIER, lw=1.2, ls="--", path_effects=edge, label=label))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    total = result.account["multi"].inliers
    ax.set_title(
        f"{total:,} of {len(corr):,} matches are inliers, of which a sample is shown\n"
        "(one that several operators found counts for each of them)"
    )
    return figure


def _side_by_side(image1: Any, image2: Any) -> tuple[Figure, Axes, int]:
    """Draw two photographs with axes in pixels of the first; also return the x of the second."""
    first, second = (getattr(image, "rgb", image) for image in (image1, image2))
    (h1, w1), (h2, w2) = first.shape[:2], second.shape[:2]
    shift = round(1.02 * w1)
    thin = max(1, round((w1 + w2) / 3000))  # a page has no more pixels
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


def _lines(
    ax: Axes, a: np.ndarray, b: np.ndarray, rows: np.ndarray, colour: str, **style: Any
) -> None:
    """Draw lines from a to b with a dark edge, and dots at both ends."""
    segments = np.stack([a[rows], b[rows]], 1)
    edge = _casing(1.2)
    ax.add_collection(
        LineCollection(segments, colors=colour, linewidths=1.2, path_effects=edge, **style)
    )
    x, y = segments.reshape(-1, 2).T
    ax.scatter(x, y, s=9, color=colour, edgecolors=CASING, linewidths=0.5, zorder=3)


def _casing(width: float) -> list[Any]:
    return [withStroke(linewidth=width + 1.2, foreground=CASING)]


def epipolar_figure(
    image1: Any, image2: Any, x1: Any, lines2: Any, x2: Any | None = None, lines1: Any | None = None
) -> Figure:
    """Draw points of image 1 and their epipolar lines in image 2, in the same colours.

    Args:
        x1: (N, 2) pixels of image 1.
        lines2: (N, 3) lines in image 2, ``a x + b y + c = 0``.
        x2: (N, 2) pixels of the matches in image 2.
        lines1: (N, 3) epipolar lines of x2 in image 1.
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
    """Return the unit of lengths of a cloud with a leading space; empty if unknown."""
    return " baselines" if cloud.operators else ""


def cloud_figure(
    cloud: PointCloud, *, colour: Any | None = None, label: str = "", cameras: Any | None = None
) -> Figure:
    """Draw a cloud along the z axis and along the y axis of camera 1.

    At most 200,000 points are drawn, and only the inner 98 % in each direction.

    Args:
        cloud: M points.
        colour: (M,) numbers that determine the colours; None for the colours of the photograph.
        label: Quantity and unit of these numbers.
        cameras: (2, 3) centres of the cameras, drawn in the second view.
    """
    near = _shown(cloud)
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    axes = figure.subplots(1, 2)
    shades = cloud.rgb.numpy()[near] / 255 if colour is None else np.asarray(colour)[near]
    dots = _two_sides(axes, cloud, near, shades, "cividis")
    if cameras is not None:
        for number, (x, _, z) in enumerate(np.asarray(cameras), start=1):
            axes[1].plot(x, z, "^", ms=8, color="black")
            # Outwards, because the cameras are close to each other.
            side, where = (-7, "right") if x < np.mean(np.asarray(cameras)[:, 0]) else (7, "left")
            axes[1].annotate(
                f"camera {number}", (x, z), (side, 3), textcoords="offset points", ha=where
            )
    if colour is not None:
        figure.colorbar(dots, ax=axes, label=label)
    return figure


def cloud_picture(cloud: PointCloud) -> Figure:
    """Draw a cloud in two directions, in the colours of the photograph and of the operators."""
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
    """Choose the rows of a cloud to draw."""
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
    """Draw points of a cloud along the z axis and along the y axis, on two axes."""
    X = cloud.xyz.numpy()[near]
    size = float(np.clip(40_000 / max(len(X), 1), 0.5, 4))
    for ax, j in zip(axes, (1, 2)):
        order = np.argsort(-X[:, 2] if j == 1 else -X[:, 1])  # the nearest points last, on top
        dots = ax.scatter(
            X[order, 0],
            X[order, j],
            c=shades[order],
            s=size,
            linewidths=0,
            cmap=cmap if shades.ndim == 1 else None,
        )
        label_side(ax, cloud, j)
    return dots


def label_side(ax: Axes, cloud: PointCloud, j: int) -> None:
    """Label a view of the x axis and the axis j (y or z) of a cloud.

    The view along the y axis of camera 1 is not always a view from above: the camera of a drone
    looks down, and then the view along z is from above.
    """
    ours = bool(cloud.operators)
    unit = f" ({unit_of(cloud).strip()})" if ours else ""
    down = {1: ", down", 2: ", depth"} if ours else {1: "", 2: ""}
    ax.set(aspect="equal", xlabel=f"x{unit}", ylabel=f"{'xyz'[j]}{down[j]}{unit}")
    if ours:
        ax.set_title("view of camera 1" if j == 1 else "along the y axis of camera 1")
    else:
        ax.set_title("along z" if j == 1 else "along y")
    if j == 1 and ours:
        ax.invert_yaxis()


def save(figure: Figure, path: str | Path, dpi: int = 110) -> None:
    """Write a figure to an image file without a display."""
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=dpi)
