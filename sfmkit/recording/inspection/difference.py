"""The difference between two recordings of the same photographs."""

from __future__ import annotations

from math import acos, degrees
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...pipeline.account import ALL
from ..read import Recording, RecordingError, read_recording
from ._columns import POINTS, own_columns
from ._words import angle_deg, image_words, pose_words, short, table

# Mean difference of grey values above which photographs differ. Measured: at least 12 between
# neighbours of the fountain, the temple ring and a drone flight; at most 0.6 for a JPEG of quality
# 30, 5 for the undistortion with k1 = -0.1, and 3 to 12 with k1 = -0.3.
_SAME = 10.0


def diff_recordings(a: str | Path, b: str | Path, prefix: str = "") -> str:
    """List what changed from `a` to `b`: settings, verdict, pose, statistics, points and times.

    Raises:
        RecordingError: the recordings are of different photographs.
    """
    before, after = read_recording(a), read_recording(b)
    ra, rb = before.report(prefix), after.report(prefix)
    pairs = [" and ".join(image_words(image) for image in r["images"]) for r in (ra, rb)]
    if pairs[0] != pairs[1]:
        raise RecordingError(
            f"{before.path} is of {pairs[0]}, {after.path} of {pairs[1]}: "
            "only recordings of the same photographs can be compared"
        )
    _check_photographs(before, after, prefix)
    rows = [("", str(before.path), str(after.path))]
    for label, value in (
        ("preset", lambda r: r["options"]["name"]),
        ("seed", lambda r: r["seed"]),
        (
            "focal lengths",
            lambda r: ", ".join(f"{c['K'][0][0]:.1f} px ({c['source']})" for c in r["camera"]),
        ),
        ("operators", lambda r: ", ".join(o for o in r["operators"] if o != ALL)),
        ("verdict", lambda r: r["verdict"]["kind"]),
        ("residual, px", lambda r: r["reprojection_rmse_px"]),
        ("error of rotation, deg", lambda r: r.get("errors", {}).get("rotation_deg")),
        ("error of translation, deg", lambda r: r.get("errors", {}).get("translation_deg")),
        ("total time, s", lambda r: r["timings_s"].get("total")),
        ("versions", lambda r: ", ".join(f"{k} {v}" for k, v in r["versions"].items())),
    ):
        if value(ra) != value(rb):
            rows.append((label, short(value(ra)), short(value(rb))))
    changed = (
        table(("changed", "from", "to"), rows, left=3)
        if len(rows) > 1
        else "The settings and results are the same."
    )
    return "\n\n".join(
        [changed, _diff_pose(ra, rb), _diff_account(ra, rb), _diff_points(before, after, prefix)]
    )


def _check_photographs(a: Recording, b: Recording, prefix: str) -> None:
    """Compare the recorded photographs, reduced to 64 pixels: their compression may differ.

    Raises:
        RecordingError: they show different things.
    """
    for number in (1, 2):
        entity = f"{prefix}/matches/photo{number}"
        if entity not in a or entity not in b:
            continue
        small = [_reduced(r.latest(entity)["EncodedImage:blob"][0]) for r in (a, b)]
        apart = float(np.abs(small[0] - small[1]).mean())
        if apart > _SAME:
            raise RecordingError(
                f"image {number} of {a.path} and of {b.path} are different photographs of the same "
                f"name and size (mean difference {apart:.0f} of 255 grey values): only recordings "
                "of the same photographs can be compared"
            )


def _reduced(jpeg: Any) -> np.ndarray:
    """Decode a photograph to 64 x 64 grey values."""
    grey = cv2.imdecode(np.asarray(jpeg, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    return cv2.resize(grey, (64, 64), interpolation=cv2.INTER_AREA).astype(np.float64)


def _diff_pose(a: dict[str, Any], b: dict[str, Any]) -> str:
    if a["pose"] is None or b["pose"] is None:
        return f"pose: {pose_words(a)}  ->  {pose_words(b)}"
    Ra, Rb = (np.array(r["pose"]["R"]) for r in (a, b))
    words = f"The rotations differ by {angle_deg(Ra.T @ Rb):.4f} deg"
    if a["pose"]["t"] and b["pose"]["t"]:
        cosine = float(np.dot(a["pose"]["t"], b["pose"]["t"]))
        apart = degrees(acos(max(-1.0, min(1.0, cosine))))
        words += f", the directions of translation by {apart:.4f} deg"
    return words + "."


def _diff_account(a: dict[str, Any], b: dict[str, Any]) -> str:
    rows = []
    for name in dict.fromkeys([*a["operators"], *b["operators"]]):
        lines = [r["operators"].get(name) for r in (a, b)]
        cells = []
        for key in ("matches", "initial", "inliers", "points"):
            va, vb = (0 if line is None else line[key] for line in lines)
            cells.append(f"{vb:,} ({vb - va:+,})" if va != vb else f"{vb:,}")
        rows.append((("all" if name == ALL else name), *cells))
    return table(("operator", "matches", "fused", "inliers", "points"), rows)


def _diff_points(a: Recording, b: Recording, prefix: str) -> str:
    """Count the points that have the same pixels in both, and say how far they moved."""
    entity = f"{prefix}/{POINTS}"
    if entity not in a or entity not in b:
        return "points: one of the recordings has no cloud."
    where = []
    for recording in (a, b):
        cloud = own_columns(recording, entity)
        keys = np.round(np.hstack([cloud["x1"], cloud["x2"]]) * 100).astype(
            np.int64
        )  # a hundredth of a pixel
        xyz = recording.latest(entity)["Points3D:positions"]
        where.append({tuple(key): p for key, p in zip(keys.tolist(), xyz)})
    both = where[0].keys() & where[1].keys()
    only = [len(w) - len(both) for w in where]
    words = (
        f"{len(both):,} points have the same pixels in both, {only[0]:,} are gone, "
        f"{only[1]:,} are new."
    )
    if both:
        moved = np.median([np.linalg.norm(where[0][k] - where[1][k]) for k in both])
        words += f" The common ones moved by {moved:.4g} baselines (median)."
    return words
