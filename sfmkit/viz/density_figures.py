"""Figures of the density of a cloud, as in Figures 13 to 17 of the paper."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..clouds.density import Density, Histogram, default_classes, histogram
from ..types import PointCloud
from .figures import cloud_figure, unit_of

COLOURS = "cividis"  # distinguishable with all kinds of colour vision
# percentile of the counts with the last colour, so that a few outliers do not darken the others
_BRIGHTEST = 98


def colours(neighbours: np.ndarray) -> np.ndarray:
    """Map (N,) counts to (N, 3) uint8 colours, dark for few and bright for many."""
    top = np.percentile(neighbours, _BRIGHTEST)
    low = neighbours.min()
    table = colormaps[COLOURS](np.arange(256), bytes=True)[:, :3]
    return table[
        np.rint(255 * np.clip((neighbours - low) / max(top - low, 1), 0, 1)).astype(np.uint8)
    ]


def density_figure(cloud: PointCloud, density: Density) -> Figure:
    """Draw the cloud in two directions, coloured by the number of neighbours."""
    n = density.neighbours
    label = f"points within {density.radius:.3g}{unit_of(cloud)} (the point itself included)"
    return cloud_figure(cloud, colour=np.minimum(n, np.percentile(n, _BRIGHTEST)), label=label)


def histogram_figure(density: Density, own: Histogram) -> Figure:
    """Draw histograms with integer class width and as in CloudCompare, with Gaussians."""
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    theirs = histogram(density.neighbours, default_classes(len(density.neighbours)))
    width = own.edges[1] - own.edges[0]
    _bars(left, own, f"{own.classes} classes of {width:.0f}")
    _bars(
        right,
        theirs,
        f"{theirs.classes} classes: root of the number of points, as CloudCompare does",
    )
    figure.suptitle(
        f"{len(density.neighbours):,} points, radius {density.radius:.3g}: "
        f"mean {own.mean:.2f}, standard deviation {own.std:.2f} neighbours",
        fontsize="medium",
    )
    return figure


def _bars(ax: Axes, h: Histogram, title: str) -> None:
    middle = (h.edges[1:] + h.edges[:-1]) / 2
    ax.bar(
        middle, h.counts, width=np.diff(h.edges), color="#56B4E9", edgecolor="none", label="points"
    )
    if h.std > 0:
        x = np.linspace(h.edges[0], h.edges[-1], 400)
        ax.plot(x, h.gaussian(x), color="#D55E00", label="Gaussian of this mean and deviation")
    ax.set(xlabel="neighbours of a point", ylabel="points")
    ax.set_title(title, fontsize="medium")
    ax.legend(frameon=False)
