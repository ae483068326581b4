"""Answers about pixels, matches, points and rejections in text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import OperatorError
from ..read import RecordingError, read_recording
from ..trace import MERGED, POINT, UNMATCHED
from ._words import table
from .lives import keypoint_life, match_life, matching_rule, point_life, reasons
from .tables import Tables, read_tables

RADIUS_PX = 5.0  # a keypoint further away does not belong to a clicked pixel
_MOST = 8  # lives printed for one pixel
HEAD = ("stage", "reason", "rejected", "share", "examples")  # of `rejection_rows`


@dataclass(frozen=True)
class Rejection:
    """How many lives ended for one reason.

    Attributes:
        stage: match, fuse, estimate or triangulate.
        operator: whose keypoints ended; None for fused matches.
        reason: as in docs/recording.md.
        count, of: how many ended so, of how many that reached the stage.
        examples: rows of the first of them: matches, or keypoints of image 1.
        why: the rule, with the limits of the run.
    """

    stage: str
    operator: str | None
    reason: str
    count: int
    of: int
    examples: tuple[int, ...]
    why: str


def rejections(tables: Tables, operator: str | None = None) -> tuple[Rejection, ...]:
    """Count the reasons for which keypoints and matches of one operator, or of all, ended.

    Keypoints are those of image 1. A fused match counts for every operator that found it.

    Raises:
        OperatorError: the recording has no such operator.
    """
    if operator is not None and operator not in tables.operators:
        raise OperatorError.unknown(operator, tables.operators)
    found = []
    for name in tables.operators if operator is None else (operator,):
        k = tables.keypoints[name][0]
        lost, merged = np.flatnonzero(k.partner < 0), np.flatnonzero(k.merged)
        rule = matching_rule(tables, name)
        for stage, reason, rows, of, why in (
            ("match", UNMATCHED, lost, len(k.xy), rule),
            ("fuse", MERGED, merged, len(k.xy) - len(lost), "one of several coincident matches is "
             "kept"),
        ):  # fmt: skip
            if len(rows):
                some = tuple(rows[:3].tolist())
                found.append(Rejection(stage, name, reason, len(rows), of, some, why))
    m = tables.matches
    mine = np.ones(len(m.kept), dtype=bool)
    if operator is not None:
        mine = (m.mask >> tables.operators.index(operator) & 1).astype(bool)
    explained = reasons(tables)
    for fate in np.unique(m.fate[mine]).tolist():
        if fate != POINT:
            rows = np.flatnonzero(mine & (m.fate == fate))
            stage = "triangulate" if fate.startswith("inlier") else "estimate"
            some = tuple(rows[:3].tolist())
            found.append(
                Rejection(stage, None, fate, len(rows), int(mine.sum()), some, explained[fate])
            )
    return tuple(found)


def rejection_rows(tables: Tables, found: Sequence[Rejection]) -> list[tuple[str, ...]]:
    """Put rejections into words, one row each with the columns :data:`HEAD`.

    An example of a keypoint is its pixel in image 1, an example of a match its number.
    """
    return [
        (
            r.stage,
            f"{r.operator}: {r.reason}" if r.operator else r.reason,
            f"{r.count:,} of {r.of:,}",
            f"{r.count / r.of:.1%}",
            "  ".join(_example(tables, r.operator, n) for n in r.examples),
        )
        for r in found
    ]


def _example(tables: Tables, operator: str | None, n: int) -> str:
    if operator is None:
        return str(n)
    return ",".join(f"{v:.1f}" for v in tables.keypoints[operator][0].xy[n])


def describe_rejected(path: str | Path, operator: str | None = None, prefix: str = "") -> str:
    """Tabulate why keypoints and matches were rejected, with counts and examples."""
    tables = read_tables(read_recording(path), prefix)
    found = rejections(tables, operator)
    rules = dict.fromkeys(f"{r.reason}: {r.why}" for r in found)
    return "\n".join(
        [
            table(HEAD, rejection_rows(tables, found), left=len(HEAD)),
            "",
            "Examples of keypoints are pixels of image 1 (--pixel X,Y), others are matches "
            "(--match N).",
            *rules,
        ]
    )


def describe_point(path: str | Path, n: int, prefix: str = "") -> str:
    """Describe the life of point `n` of the cloud."""
    return str(point_life(read_tables(read_recording(path), prefix), n))


def describe_match(path: str | Path, n: int, prefix: str = "") -> str:
    """Describe the life of match `n` of the fused correspondences."""
    return str(match_life(read_tables(read_recording(path), prefix), n))


def describe_pixel(path: str | Path, x: float, y: float, image: int = 1, prefix: str = "") -> str:
    """Describe the lives of the keypoints within 5 px of a pixel, or name the nearest one.

    Raises:
        RecordingError: the pixel is outside the photograph, or there are no keypoints.
    """
    tables = read_tables(read_recording(path), prefix)
    w, h = tables.report["images"][image - 1]["size_wh"]
    if not (-0.5 <= x <= w - 0.5 and -0.5 <= y <= h - 0.5):
        raise RecordingError(f"({x:g}, {y:g}) is outside image {image}, which has {w} x {h} pixels")
    near = keypoints_near(tables, x, y, image)
    if not near:
        raise RecordingError(f"{path} has no keypoints in image {image}")
    within = [n for n in near if n[0] <= RADIUS_PX]
    head = f"({x:g}, {y:g}) of image {image}: "
    if not within:
        distance, name, k = near[0]
        return (
            f"{head}no keypoint within {RADIUS_PX:g} px; the nearest is {distance:.1f} px away\n\n"
            f"{keypoint_life(tables, name, image, k)}"
        )
    shown = within[:_MOST]
    more = f", the nearest {_MOST} of them" if len(within) > _MOST else ""
    count = "1 keypoint" if len(within) == 1 else f"{len(within)} keypoints"
    lives = [str(keypoint_life(tables, name, image, k)) for _, name, k in shown]
    return "\n\n".join([f"{head}{count} within {RADIUS_PX:g} px{more}", *lives])


def keypoints_near(tables: Tables, x: float, y: float, image: int) -> list[tuple[float, str, int]]:
    """List distance in pixels, operator and row of each operator's nearest keypoints, sorted."""
    found = []
    for name in tables.operators:
        distance = np.hypot(*(tables.keypoints[name][image - 1].xy - (x, y)).T)
        if len(distance):
            rows = set(np.flatnonzero(distance <= RADIUS_PX).tolist()) | {int(distance.argmin())}
            found += [(float(distance[k]), name, k) for k in rows]
    return sorted(found)
