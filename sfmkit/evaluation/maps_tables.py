"""Tables of the benchmark of many views."""

from __future__ import annotations

from collections.abc import Sequence

from ..reports.result import Cell, Column, Result, ResultTable
from .rows import Row

__all__ = ["maps_result"]

_COLUMNS = (
    (Column("recipe"), "recipe"),
    (Column("registered", ">"), ""),
    (Column("points", ","), "points"),
    (Column("track length", ".2f"), "track_length"),
    (Column("error (px)", ".3f"), "error_px"),
    (Column("position, median (mm)", ".2f"), "position_mm"),
    (Column("worst (mm)", ".2f"), "position_worst_mm"),
    (Column("rotation, median (deg)", ".4f"), "rotation_deg"),
    (Column("worst (deg)", ".4f"), "rotation_worst_deg"),
    (Column("common rotation (deg)", ".4f"), "rotation_common_deg"),
    (Column("rotation without it, median (deg)", ".4f"), "rotation_rest_deg"),
    (Column("pairs (s of processor)", ".0f"), "pairs_cpu_s"),
    (Column("mapping (s)", ".0f"), "map_s"),
)


def maps_result(rows: Sequence[Row], command: str) -> Result:
    """Make one table per scene."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    return Result(
        name="map",
        title="Many views: operators alone and together, and COLMAP's SIFT, with COLMAP's mapper",
        command=command,
        tables=tuple(_table(scene, [r for r in rows if r["scene"] == scene]) for scene in scenes),
        seeds=(0,),
        notes=(
            "All recipes use the same photographs, the same longest side for detection, the same "
            "number of keypoints per operator, all pairs, the same camera and COLMAP's incremental "
            "mapper. Given intrinsics are held fixed.",
            "Error is COLMAP's mean reprojection error, in pixels of the photographs. Positions "
            "and rotations are compared with the truth after the alignment of the positions by a "
            "similarity. The common rotation is the part of the rotation errors that all cameras "
            "share; positions near a line determine the rotation about it badly.",
            "Processor time of the pairs is that of detection, matching and two-view geometry. "
            "The mapping time is wall time and depends on the load of the machine.",
        ),
    )


def _table(scene: str, rows: Sequence[Row]) -> ResultTable:
    return ResultTable(
        name=scene.lower().replace(" ", "-"),
        title=f"{scene}: {rows[0]['photographs']} photographs",
        columns=tuple(column for column, _ in _COLUMNS),
        rows=tuple(tuple(_cell(row, key) for _, key in _COLUMNS) for row in rows),
    )


def _cell(row: Row, key: str) -> Cell:
    return row.get(key) if key else f"{row['registered']} of {row['photographs']}"
