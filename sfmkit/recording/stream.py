"""How anything gets into a recording: paths below a prefix, stages, our own columns, and the looks
of marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from matplotlib import colormaps

from ..types import Camera

STAGES = ("read", "detect", "match", "fuse", "estimate", "pose", "triangulate", "refine")
GREY = (128, 128, 128)
MAGENTA = (255, 0, 255)

Cameras = tuple[Camera, Camera]


def put(
    rec: rr.RecordingStream,
    prefix: str,
    at: str | Sequence[str],
    *what: Any,
    stage: str | None = None,
) -> None:
    """Log `what` below the prefix at a stage, or for all time. Names in a sequence may hold any
    character."""
    head, *names = [at] if isinstance(at, str) else at
    path = "/".join(
        part for part in (prefix.strip("/"), head, *map(rr.escape_entity_path_part, names)) if part
    )
    if stage is not None:
        rec.set_time("stage", sequence=STAGES.index(stage))
    rec.log(path or "/", *what, static=stage is None)


def columns(**values: Any) -> rr.DynamicArchetype:
    """Values of our own, one for each mark, under the name ``sfmkit:<name>``; integers as 32 bit,
    floats as float32."""

    def arrow(value: Any) -> pa.Array:
        a = np.asarray(value)
        if a.dtype.kind == "f":
            a = a.astype(np.float32)
        elif a.dtype.kind in "iu":
            a = a.astype(np.int32)
        return (
            pa.FixedSizeListArray.from_arrays(pa.array(a.ravel()), a.shape[1])
            if a.ndim == 2
            else pa.array(a)
        )

    return rr.DynamicArchetype(
        "sfmkit", components={name: arrow(value) for name, value in values.items()}
    )


def strokes(segments: np.ndarray, *, width: float, **look: Any) -> rr.LineStrips2D:
    """Segments (N, 2, 2), `width` UI points thick."""
    return rr.LineStrips2D(
        segments.astype(np.float32), radii=rr.Radius.ui_points(width / 2), show_labels=False, **look
    )


def pinhole(camera: Camera, distance: float, **look: Any) -> rr.Pinhole:
    return rr.Pinhole(
        image_from_camera=camera.K,
        resolution=camera.size_wh,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=distance,
        **look,
    )


def ramp(values: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 colours, dark blue to yellow from the 5th to the 95th percentile, for any kind
    of colour vision."""
    low, high = np.percentile(values, (5, 95))
    return (
        colormaps["cividis"](np.clip((values - low) / max(high - low, 1e-12), 0, 1))[:, :3] * 255
    ).astype(np.uint8)


def log_survivors(
    rec: rr.RecordingStream,
    prefix: str,
    number: int,
    alive: Sequence[tuple[np.ndarray, np.ndarray]],
    stage: str,
) -> None:
    """What is still in the running at a stage, in one image: positions and class ids, replaced at
    the next stage."""
    x = np.concatenate([a[0] for a in alive]) if alive else np.zeros((0, 2))
    k = np.concatenate([a[1] for a in alive]) if alive else np.zeros(0, dtype=int)
    dots = rr.Points2D(x, class_ids=k, radii=rr.Radius.ui_points(1))
    put(rec, prefix, f"world/cam{number}/image/survivors", dots, stage=stage)


def side_by_side(x1: np.ndarray, x2: np.ndarray, cameras: Cameras, **look: Any) -> rr.LineStrips2D:
    return strokes(np.stack([x1, x2 + np.array([beside(cameras), 0])], 1), width=0.6, **look)


def beside(cameras: Cameras) -> int:
    """How far image 2 is shifted to the right where the images stand side by side, pixels."""
    w1, w2 = cameras[0].size_wh[0], cameras[1].size_wh[0]
    return w1 + round(0.01 * (w1 + w2))


def dot_radius(n: int) -> rr.Radius:
    """The radius of n dots in one view: small enough to see between many, large enough to click one
    of few."""
    return rr.Radius.ui_points(float(np.clip(150 / max(n, 1) ** 0.5, 1, 1.8)))
