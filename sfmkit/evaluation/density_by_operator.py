"""Density of a cloud (the paper's Figures 13 to 17), and a test of the paper's claim about edges.

The paper claims that the clouds are denser at edges and corners. For each feature of
:mod:`sfmkit.clouds.local_shape`, the test compares the neighbour counts of the quarter of the
points that look most like an edge with the counts of the other points. The effect size is Cliff's
delta. Its interval comes from a bootstrap over cells of space that are four radii wide, because
neighbouring points have similar counts.

A sphere around a point near a crease contains more surface than a sphere on a plane: a uniformly
covered box has a delta of +0.4 for the surface variation. Only a larger delta can be attributed to
the detectors.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .._utils.progress import Progress
from .._utils.writing import staged_folder
from ..clouds.density import Density, Histogram, default_classes, density, histogram
from ..clouds.local_shape import LocalShape, local_shape
from ..io.ply import write_ply
from ..types import PointCloud
from .effect_size import Effect, cliffs_delta

EDGE_SHARE = 0.25  # share of the points that count as edge points
CELL = 4  # width of a bootstrap cell in radii; counts of distant points share no points
_FEW = (100, 10)  # least numbers of points and cells for a comparison


@dataclass(frozen=True, eq=False)
class DensityReport:
    """Density of a cloud and its relation to edges.

    Attributes:
        cloud: The cloud.
        density: Density at each point.
        shape: Local shape around each point, or around a sample of the points.
        histogram: Histogram of the counts, with integer class widths.
        effects: Feature -> effect size of its upper quarter on the counts; empty if too few points
            have enough neighbours, or if the radius is so large that the points lie in a few cells.
    """

    cloud: PointCloud
    density: Density
    shape: LocalShape
    histogram: Histogram
    effects: dict[str, Effect]

    def numbers(self) -> dict[str, Any]:
        """Return all results except the points as JSON values."""
        n, h = self.density.neighbours, self.histogram
        return {
            "points": len(n),
            "radius": self.density.radius,
            "neighbours": {
                "counted": "points at a distance of at most the radius, the point itself included",
                "min": int(n.min()),
                "median": float(np.median(n)),
                "max": int(n.max()),
                "mean": h.mean,
                "std": h.std,
            },
            "surface_density": {
                "mean": float(self.density.surface.mean()),
                "std": float(self.density.surface.std()),
            },
            "volume_density": {
                "mean": float(self.density.volume.mean()),
                "std": float(self.density.volume.std()),
            },
            "histogram": {
                "edges": h.edges.tolist(),
                "counts": h.counts.tolist(),
                "cloudcompare_classes": default_classes(len(n)),
            },
            "edges": {
                "judged": int(self.shape.known.sum()),
                "of": len(self.shape.index),
                "share": EDGE_SHARE,
                "cliffs_delta": {name: effect._asdict() for name, effect in self.effects.items()},
            },
        }


def density_report(
    cloud: PointCloud, radius: float | None = None, *, progress: Progress | None = None
) -> DensityReport:
    """Count neighbours, measure local shapes and compare edge points with the others.

    Args:
        radius: Radius in the unit of the cloud; None for ten times the spacing of its points.
        progress: Called with (stage, detail).

    Raises:
        InputError: As for :func:`sfmkit.clouds.density.density`.
    """
    xyz = cloud.xyz.numpy()
    found = density(xyz, radius, progress=progress)
    shape = local_shape(xyz, found.radius, found.neighbours, progress=progress)
    if progress is not None:
        progress("compare", "edges with the rest")
    return DensityReport(
        cloud, found, shape, histogram(found.neighbours), _effects(xyz, found, shape)
    )


def _effects(xyz: np.ndarray, found: Density, shape: LocalShape) -> dict[str, Effect]:
    known = shape.known
    rows = shape.index[known]
    _, cells = np.unique(np.floor(xyz[rows] / (CELL * found.radius)), axis=0, return_inverse=True)
    if len(rows) < _FEW[0] or cells.max() + 1 < _FEW[1]:
        return {}
    effects = {}
    for name, values in shape.features().items():
        edge = values[known] > np.quantile(values[known], 1 - EDGE_SHARE)
        if edge.any():  # otherwise the feature is constant
            effects[name] = cliffs_delta(found.neighbours[rows], edge, cells)
    return effects


def write_density(report: DensityReport, folder: Path, *, overwrite: bool = False) -> None:
    """Write ``density.json``, ``density.ply``, ``density.png`` and ``histogram.png``, all or none.

    The points of the PLY file are coloured by their counts. Their properties are ``neighbours``,
    ``surface_density``, ``volume_density`` and the features of the local shape (NaN where they were
    not measured).

    Raises:
        OutputError: The folder exists or cannot be written.
    """
    from ..viz import density_figures
    from ..viz.figures import save

    with staged_folder(folder, overwrite=overwrite) as staged:
        (staged / "density.json").write_text(
            json.dumps(report.numbers(), indent=1), encoding="utf-8"
        )
        fields = {
            "neighbours": report.density.neighbours,
            "surface_density": report.density.surface,
            "volume_density": report.density.volume,
        }
        for name, values in report.shape.features().items():
            fields[name] = np.full(len(report.cloud), np.nan, dtype=np.float32)
            fields[name][report.shape.index] = values
        coloured = replace(
            report.cloud, rgb=torch.from_numpy(density_figures.colours(report.density.neighbours))
        )
        write_ply(
            staged / "density.ply",
            coloured,
            {name: torch.from_numpy(values) for name, values in fields.items()},
        )
        save(density_figures.density_figure(report.cloud, report.density), staged / "density.png")
        save(
            density_figures.histogram_figure(report.density, report.histogram),
            staged / "histogram.png",
        )
