"""Basics of a recording: streams, entity paths, stages, own columns, and the look of marks."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from matplotlib import colormaps
from rerun.chunk import RrdReader

from .._utils.writing import atomic_write
from ..errors import InputError, OutputError
from ..types import Camera
from .read import read_recording

STAGES = ("read", "detect", "match", "fuse", "estimate", "pose", "refine", "triangulate")
GREY = (128, 128, 128)
MAGENTA = (255, 0, 255)
GREEN = (0, 158, 115)

APPLICATION = "sfmkit"  # recordings of one application share the layout of their views
Cameras = tuple[Camera, Camera]
Size = tuple[int, int]
Details = Mapping[str, Any]


def new_stream(name: str) -> rr.RecordingStream:
    """Make an empty stream that keeps what is logged in memory until it is written.

    Args:
        name: recording id. The viewer shows files with the same id as one recording.
    """
    rec = rr.RecordingStream(APPLICATION, recording_id=name, send_properties=False)
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    return rec


def drain(rec: rr.RecordingStream, blueprint: Any = None) -> bytes:
    """Take everything that was logged out of a stream, as the content of an .rrd file.

    Files are not written by Rerun itself, for two reasons (0.41, on a full disk): a flush of its
    file sink never returns and cannot be interrupted, and a failed write is not reported.

    The blueprint is made active: the viewer lays out a recording by itself as soon as its data
    arrive, and keeps that layout if the blueprint that follows is only the default one.

    Args:
        blueprint: layout of the views.
    """
    if blueprint is not None:
        rec.send_blueprint(blueprint, make_active=True, make_default=True)
    return rec.memory_recording().drain_as_bytes()


def write_stream(rec: rr.RecordingStream, path: str | Path, blueprint: Any = None) -> Path:
    """Write everything that was logged to a stream of :func:`new_stream`; more can be logged later.

    Args:
        path: the .rrd file. It appears whole or not at all; an existing file is replaced.
        blueprint: layout of the views.

    Raises:
        OutputError: the file cannot be written.
    """
    path = Path(path)
    try:
        with tempfile.TemporaryDirectory() as folder:
            kept = Path(folder) / "stream.rrd"
            kept.write_bytes(drain(rec))
            rec.disconnect()
            chunks = RrdReader(kept).stream().to_chunks()
        # Saving emptied the stream. What it held is logged again, for the next call.
        rec.send_chunks(chunks)
        write_chunks(path, rec.get_recording_id(), chunks, blueprint)
    except (RuntimeError, ValueError, OSError) as error:
        raise OutputError(f"{path} cannot be written: {error}") from error
    return path


def write_chunks(path: Path, name: str, chunks: Sequence[Any], blueprint: Any = None) -> None:
    """Write chunks to one file with the recording id `name`."""
    with atomic_write(path) as temporary:
        out = new_stream(name)
        try:
            out.send_recording_name(name)
            out.send_chunks(chunks)
            temporary.write_bytes(drain(out, blueprint))
        finally:
            out.disconnect()


def recording_ids(path: str | Path) -> set[str]:
    """The ids of the recordings in a file."""
    return {entry.recording_id for entry in RrdReader(path).recordings()}


def merge_recordings(
    path: str | Path, sources: Sequence[str | Path], blueprint: Any = None
) -> Path:
    """Write the contents of several recordings with the same id to one file, the last one on top.

    Raises:
        InputError: no sources, sources with different recording ids, or a damaged one.
        OutputError: the file cannot be written.
    """
    path = Path(path)
    for source in sources:
        read_recording(source)  # a damaged file would abort this process
    names = {name for source in sources for name in recording_ids(source)}
    if len(names) != 1:
        raise InputError(
            f"{path}: the recordings to merge have {len(names)} different ids, not one"
        )
    chunks = [chunk for source in sources for chunk in RrdReader(source).stream()]
    try:
        write_chunks(path, names.pop(), chunks, blueprint)
    except (RuntimeError, ValueError) as error:
        raise OutputError(f"{path} cannot be written: {error}") from error
    return path


def put(
    rec: rr.RecordingStream,
    prefix: str,
    at: str | Sequence[str],
    *what: Any,
    stage: str | None = None,
) -> None:
    """Log `what` below the prefix at a stage, or static.

    Args:
        at: entity path. In a sequence, all names after the first may hold any character.
    """
    head, *names = [at] if isinstance(at, str) else at
    path = "/".join(
        part for part in (prefix.strip("/"), head, *map(rr.escape_entity_path_part, names)) if part
    )
    if stage is not None:
        rec.set_time("stage", sequence=STAGES.index(stage))
    rec.log(path or "/", *(w for w in what if w is not None), static=stage is None)


def columns(**values: Any) -> rr.DynamicArchetype | None:
    """Own columns, one value for each mark, under the name ``sfmkit:<name>``.

    Integers are stored as int32, floats as float32. None without values.
    """
    if not values:
        return None

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


def points_2d(name: str, x: Any, n: int | None = None) -> np.ndarray:
    """Pixels as (N, 2) float64.

    Raises:
        InputError: another shape, another number than `n`, or values that are not finite.
    """
    a = np.asarray(x, dtype=np.float64)
    if a.ndim != 2 or a.shape[1] != 2 or (n is not None and len(a) != n):
        raise InputError(f"{name} must be {'N' if n is None else n} x 2 pixels, not {a.shape}")
    if not np.isfinite(a).all():
        raise InputError(f"{name} holds NaN or infinite values")
    return a


def strokes(segments: np.ndarray, *, width: float, **look: Any) -> rr.LineStrips2D:
    """Segments (N, 2, 2), `width` UI points thick."""
    return rr.LineStrips2D(
        segments.astype(np.float32), radii=rr.Radius.ui_points(width / 2), show_labels=False, **look
    )


def pinhole(camera: Camera, distance: float, **look: Any) -> rr.Pinhole:
    """A camera's pinhole model, its image plane drawn at `distance` baselines."""
    return rr.Pinhole(
        image_from_camera=camera.K,
        resolution=camera.size_wh,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=distance,
        **look,
    )


def ramp(values: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 colours, dark blue to yellow from the 5th to the 95th percentile.

    The colour map cividis is readable with every kind of colour vision.
    """
    low, high = np.percentile(values, (5, 95))
    return (
        colormaps["cividis"](np.clip((values - low) / max(high - low, 1e-12), 0, 1))[:, :3] * 255
    ).astype(np.uint8)


def beside(width1: int) -> int:
    """x of image 2's left edge where the images lie side by side, pixels."""
    return round(1.02 * width1)


def dot_radius(n: int) -> rr.Radius:
    """Radius of n dots in one view: thin enough to see the photograph, thick enough to click."""
    return rr.Radius.ui_points(float(np.clip(150 / max(n, 1) ** 0.5, 1, 1.8)))
