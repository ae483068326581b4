"""Log the cloud: its points in several colourings, rays, residuals and uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from ..errors import InputError
from ..types import PointCloud
from ..viz.colours import operator_rgb
from . import marks
from .log_photos import MULTI
from .scales import log_scale, percentile_ticks
from .stream import Details, columns, dot_radius, points_2d, put, ramp, strokes
from .trace import joined_names

RESIDUAL_GAIN = 50  # residuals are drawn this many times longer than they are
SIGMAS = 3  # of the drawn ellipsoids


def log_cloud(
    rec: rr.RecordingStream,
    cloud: PointCloud | Any,
    *,
    rgb: Any = None,
    operators: Sequence[str] | None = None,
    parallax_deg: Any = None,
    details: Details | None = None,
    prefix: str = "",
) -> None:
    """Log points in the colours of the photograph, of the operators, of density and of parallax.

    Args:
        cloud: point cloud, or (M, 3) points in the frame of camera 1, baselines.
        rgb: (M, 3) uint8 colours; without them there is no layer ``photograph``.
        operators: (M,) name of each point's operator.
        parallax_deg: (M,) angle between the two rays; without it there is no such layer.
        details: further columns, (M,) or (M, d) each.

    Raises:
        InputError: arrays of another shape.
    """
    own = dict(details or {})
    if isinstance(cloud, PointCloud):
        own = _cloud_columns(cloud) | own
        rgb, parallax_deg = cloud.rgb.numpy(), cloud.parallax.numpy()
        operators = own["operator"]
        cloud = cloud.xyz
    xyz = _points_3d(cloud)
    names = [MULTI] * len(xyz) if operators is None else list(operators)
    if parallax_deg is not None:
        own.setdefault("parallax_deg", parallax_deg)
    own = {"point": np.arange(len(xyz)), **own}
    density = marks.neighbour_density(xyz) if len(xyz) > 1 else None
    if density is not None:
        log_scale(rec, "density", percentile_ticks(density, logarithmic=True), prefix)
    if parallax_deg is not None and len(xyz):
        ticks = percentile_ticks(np.asarray(parallax_deg), logarithmic=False)
        log_scale(rec, "parallax", ticks, prefix)
    layers = {
        "photograph": rgb,
        "operator": operator_colours(names),
        "density": None if density is None else ramp(np.log(density)),
        "parallax": None if parallax_deg is None else ramp(np.asarray(parallax_deg)),
    }
    for layer, colours in layers.items():
        if colours is not None:
            if len(colours) != len(xyz):
                raise InputError(f"{layer} has {len(colours)} values for {len(xyz)} points")
            dots = rr.Points3D(xyz, colors=colours, radii=dot_radius(len(xyz)))
            put(rec, prefix, f"world/points/{layer}", dots, columns(**own), stage="triangulate")


def log_rays(
    rec: rr.RecordingStream,
    xyz: Any,
    centre2: Any,
    *,
    x1: Any = None,
    x2: Any = None,
    names: Sequence[str] | None = None,
    details: Details | None = None,
    operators: Sequence[str] | None = None,
    prefix: str = "",
) -> None:
    """Log the two rays of some points, and the points in both photographs.

    Args:
        xyz: (M, 3) points in the frame of camera 1, baselines.
        centre2: (3,) centre of camera 2, ``-R^T t``.
        x1, x2: (M, 2) pixels of the points in the photographs.
        names: (M,) labels in the photographs.
        details: columns, (M,) each.
        operators: (M,) names that give the colours.
    """
    xyz = _points_3d(xyz)
    colours = operator_colours([MULTI] * len(xyz) if operators is None else operators)
    own = columns(**{"point": np.arange(len(xyz)), **(details or {})})
    ends = np.stack([np.zeros_like(xyz), xyz, np.broadcast_to(np.asarray(centre2), xyz.shape)], 1)
    strips = np.concatenate([ends[:, [0, 1]], ends[:, [2, 1]]])
    rays = rr.LineStrips3D(
        strips, colors=np.tile(colours, (2, 1)), radii=rr.Radius.ui_points(1.2), show_labels=False
    )
    put(rec, prefix, "world/rays", rays, own, stage="triangulate")
    for number, x in ((1, x1), (2, x2)):
        if x is not None:
            dots = rr.Points2D(
                points_2d(f"x{number}", x, len(xyz)),
                colors=colours,
                radii=rr.Radius.ui_points(5),
                labels=None if names is None else list(names),
                show_labels=names is not None,
            )
            put(rec, prefix, f"world/cam{number}/image/chosen", dots, own, stage="triangulate")


def log_residuals(
    rec: rr.RecordingStream,
    image: int,
    x: Any,
    projected: Any,
    *,
    colours: Any = None,
    prefix: str = "",
) -> None:
    """Log reprojection residuals, from observed pixels towards projected ones, 50 times longer.

    Args:
        image: 1 or 2.
        x, projected: (M, 2) pixels without distortion.
        colours: (M, 3) uint8.
    """
    seen = points_2d("x", x)
    error = points_2d("projected", projected, len(seen)) - seen
    look = {} if colours is None else {"colors": colours}
    lines = strokes(np.stack([seen, seen + RESIDUAL_GAIN * error], 1), width=0.8, **look)
    own = columns(residual_px=np.linalg.norm(error, axis=1), point=np.arange(len(seen)))
    put(rec, prefix, f"world/cam{image}/image/residuals", lines, own, stage="triangulate")


def log_uncertainty(
    rec: rr.RecordingStream,
    cloud: PointCloud | Any,
    covariance: Any = None,
    *,
    details: Details | None = None,
    sample: int = 200,
    prefix: str = "",
) -> None:
    """Log points by their uncertainty, and 3-sigma ellipsoids of an even sample.

    Args:
        cloud: point cloud with covariance, or (M, 3) points.
        covariance: (M, 3, 3) in squared baselines.
        details: further columns, (M,) or (M, d) each.
        sample: number of ellipsoids.

    Raises:
        InputError: a cloud without covariance, or arrays of another shape.
    """
    own = dict(details or {})
    if isinstance(cloud, PointCloud):
        own = _cloud_columns(cloud) | own
        covariance = cloud.covariance if covariance is None else covariance
        cloud = cloud.xyz
    xyz = _points_3d(cloud)
    C = None if covariance is None else np.asarray(covariance, dtype=np.float64)
    if C is None or C.shape != (len(xyz), 3, 3):
        raise InputError(f"{len(xyz)} points need covariances of shape ({len(xyz)}, 3, 3)")
    sigma = marks.largest_sigma(C)
    own = {"point": np.arange(len(xyz)), **own, "sigma": sigma}
    colours = ramp(np.log(np.maximum(sigma, 1e-12)))
    ticks = percentile_ticks(np.maximum(sigma, 1e-12), logarithmic=True)
    log_scale(rec, "uncertainty", ticks, prefix)
    dots = rr.Points3D(xyz, colors=colours, radii=dot_radius(len(xyz)))
    put(rec, prefix, "world/points/uncertainty", dots, columns(**own), stage="triangulate")
    some = marks.spread(xyz[:, :2] / xyz[:, 2:], sample)
    half_sizes, quaternions = marks.ellipsoids(C[some], SIGMAS)
    shells = rr.Ellipsoids3D(
        centers=xyz[some],
        half_sizes=half_sizes,
        quaternions=quaternions,
        colors=colours[some],
        line_radii=rr.Radius.ui_points(0.5),
        show_labels=False,
    )
    drawn = columns(point=some, sigma=sigma[some])
    put(rec, prefix, "world/ellipsoids", shells, drawn, stage="triangulate")


def operator_colours(names: Sequence[str]) -> np.ndarray:
    """(N, 3) uint8 colours of N operators' names."""
    values, inverse = np.unique(np.asarray(names, dtype=str), return_inverse=True)
    table = np.array([operator_rgb(str(v)) for v in values], dtype=np.uint8).reshape(-1, 3)
    return table[inverse]


def _cloud_columns(cloud: PointCloud) -> dict[str, Any]:
    """Columns of a cloud's points."""
    own = {
        "match": cloud.match.numpy(),
        "operator": np.array(cloud.operators, dtype=str)[cloud.operator_id.numpy()],
        "operators": joined_names(cloud.operator_mask.numpy(), cloud.operators),
        "operator_mask": cloud.operator_mask.numpy(),
        "residual_px": cloud.reprojection_error.numpy(),
        "parallax_deg": cloud.parallax.numpy(),
    }
    if cloud.covariance is not None:
        own["sigma"] = marks.largest_sigma(cloud.covariance.numpy())
    return own


def _points_3d(xyz: Any) -> np.ndarray:
    a = np.asarray(xyz, dtype=np.float64)
    if a.ndim != 2 or a.shape[1] != 3 or not np.isfinite(a).all():
        raise InputError(f"points must be M x 3 finite numbers, not of shape {a.shape}")
    return a
