"""Log a model of many photographs: cameras with small photographs, and the points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..io.images import Image
from ..types import Camera, PointCloud
from .log_cloud import operator_colours
from .stream import columns, dot_radius, new_stream, pinhole, put, write_stream
from .trace import joined_names

__all__ = ["MapView", "save_map_recording"]

_THUMBNAIL = 480  # pixels, longest side
_FRUSTUM = 0.25  # of the distance between neighbouring cameras
_PREVIEWS = 4  # photographs beside the 3-D view


@dataclass(frozen=True, eq=False)
class MapView:
    """A registered photograph.

    Attributes:
        name: In the entity path.
        camera: Its intrinsics.
        R, t: (3, 3) and (3,), ``X_camera = R X_world + t``.
    """

    name: str
    camera: Camera
    R: np.ndarray
    t: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """(3,) the projection centre in the world."""
        return -self.R.T @ self.t


def save_map_recording(
    path: Path,
    cloud: PointCloud,
    views: Sequence[MapView],
    photographs: Iterator[Image],
    track_lengths: np.ndarray,
) -> Path:
    """Write a recording of a model.

    Args:
        path: The .rrd file.
        cloud: P points in the world of the model.
        views: The registered photographs.
        photographs: Their pixels, in the same order.
        track_lengths: (P,) numbers of observations.

    Raises:
        OutputError: The file cannot be written.
    """
    rec = new_stream("map")
    put(rec, "", "world", rr.ViewCoordinates.RDF)
    size = _FRUSTUM * _spacing(views)
    for view, photograph in zip(views, photographs):
        _log_view(rec, view, photograph, size)
    main = [cloud.operators[k] for k in cloud.operator_id.tolist()]
    details = columns(
        point=cloud.match.numpy(),
        operators=joined_names(cloud.operator_mask.numpy(), cloud.operators),
        photographs=track_lengths,
        error_px=cloud.reprojection_error.numpy(),
    )
    layers = {"photograph": cloud.rgb.numpy(), "operator": operator_colours(main)}
    for layer, colours in layers.items():
        dots = rr.Points3D(cloud.xyz.numpy(), colors=colours, radii=dot_radius(len(cloud)))
        put(rec, "", f"world/points/{layer}", dots, details)
    return write_stream(rec, path, _blueprint(views))


def _log_view(rec: rr.RecordingStream, view: MapView, photograph: Image, size: float) -> None:
    scale = min(1.0, _THUMBNAIL / max(photograph.size_wh))
    w, h = (max(1, round(side * scale)) for side in photograph.size_wh)
    small = cv2.resize(photograph.rgb, (w, h), interpolation=cv2.INTER_AREA)
    pose = rr.Transform3D(
        mat3x3=view.R, translation=view.t, relation=rr.TransformRelation.ChildFromParent
    )
    put(rec, "", ["world/cameras", view.name], pose)
    camera = pinhole(view.camera.scaled((w, h)), size)
    put(rec, "", ["world/cameras", view.name, "image"], camera)
    image = rr.Image(small).compress(jpeg_quality=80)
    put(rec, "", ["world/cameras", view.name, "image"], image)


def _spacing(views: Sequence[MapView]) -> float:
    """The median distance of each camera from the nearest other one; 1 for a single camera."""
    centres = np.array([view.centre for view in views])
    if len(centres) < 2:
        return 1.0
    away = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(1))) or 1.0


def _blueprint(views: Sequence[MapView]) -> rrb.Blueprint:
    def page(shown: str, hidden: str, name: str) -> rrb.Spatial3DView:
        contents = ["+ /world/**", f"- /world/points/{hidden}"]
        return rrb.Spatial3DView(origin="/world", contents=contents, name=name)

    step = max(1, len(views) // _PREVIEWS)
    previews = [
        rrb.Spatial2DView(
            origin=f"/world/cameras/{rr.escape_entity_path_part(view.name)}/image", name=view.name
        )
        for view in views[::step][:_PREVIEWS]
    ]
    tabs = rrb.Tabs(
        page("photograph", "operator", "Colours"), page("operator", "photograph", "Operators")
    )
    return rrb.Blueprint(
        rrb.Horizontal(tabs, rrb.Vertical(*previews), column_shares=[3, 1]),
        rrb.TimePanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
