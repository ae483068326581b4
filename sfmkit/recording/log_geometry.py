"""Log the two-view geometry: epipolar lines, homographies, cameras and the four poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import torch
from matplotlib import colormaps

from ..geometry.coordinates import normalize
from ..geometry.essential import decompose_essential
from ..geometry.fundamental import epipolar_lines, epipoles
from ..geometry.lines import clip_lines
from ..geometry.pose import cheirality
from ..types import Camera
from . import marks
from .stream import (
    GREEN,
    GREY,
    MAGENTA,
    Cameras,
    Details,
    Size,
    columns,
    pinhole,
    points_2d,
    put,
    strokes,
)

_FAR = 1e-12  # third coordinate of a unit vector below which an epipole is at infinity
_SAME_POSE = 1e-3  # largest difference of entries of R and t between a pose and its rounded copy


def log_epipolar_lines(
    rec: rr.RecordingStream,
    F: Any,
    x1: Any,
    x2: Any = None,
    *,
    sizes_wh: tuple[Size, Size],
    rows: Any = None,
    details: Details | None = None,
    sample: int = 12,
    prefix: str = "",
) -> None:
    """Log epipolar lines of a sample of points, the points, and both epipoles.

    A point and its line have the same colour; the same number means the same match.

    Args:
        F: (3, 3), ``x2^T F x1 = 0``, pixels.
        x1, x2: (N, 2) pixels without distortion; without x2 only image 2 gets lines.
        sizes_wh: sizes of the two images, pixels.
        rows: rows to draw; default an even sample of `sample` points.
        details: columns of the points, (N,) each.

    Raises:
        InputError: arrays of another shape.
    """
    F = torch.as_tensor(np.asarray(F), dtype=torch.float64)
    a = points_2d("x1", x1)
    b = None if x2 is None else points_2d("x2", x2, len(a))
    rows = marks.spread(a, sample) if rows is None else np.asarray(rows)
    colours = (colormaps["turbo"](np.linspace(0.05, 0.95, len(rows)))[:, :3] * 255).astype(np.uint8)
    own = {key: np.asarray(value)[rows] for key, value in (details or {}).items()}
    for number, (mine, other, A) in enumerate(((a, b, F.mT), (b, a, F)), start=1):
        at = f"world/cam{number}/image/epipolar"
        if other is not None:
            lines = epipolar_lines(A, torch.as_tensor(other[rows]))
            segments, crosses = (a.numpy() for a in clip_lines(lines, sizes_wh[number - 1]))
            drawn = strokes(segments[crosses], colors=colours[crosses], width=1.5)
            put(rec, prefix, f"{at}/lines", drawn, columns(match=rows[crosses]), stage="estimate")
        if mine is not None:
            dots = rr.Points2D(
                mine[rows],
                colors=colours,
                radii=rr.Radius.ui_points(4),
                show_labels=False,
            )
            put(rec, prefix, f"{at}/points", dots, columns(match=rows, **own), stage="estimate")
            # A number has the colour of its mark, and light colours cannot be read.
            numbers = rr.Points2D(
                mine[rows],
                colors=(20, 20, 20),
                radii=rr.Radius.ui_points(0.5),
                show_labels=True,
                labels=[str(n + 1) for n in range(len(rows))],
            )
            put(rec, prefix, f"{at}/numbers", numbers, stage="estimate")
    for number, e in enumerate(epipoles(F), start=1):
        if abs(float(e[2])) > _FAR:
            dot = rr.Points2D(
                (e[:2] / e[2]).numpy()[None],
                colors=MAGENTA,
                radii=rr.Radius.ui_points(6),
                labels=f"epipole: camera {3 - number}",
                show_labels=True,
            )
            put(rec, prefix, f"world/cam{number}/image/epipole", dot, stage="estimate")


def log_homography(
    rec: rr.RecordingStream,
    H: Any,
    *,
    sizes_wh: tuple[Size, Size],
    prefix: str = "",
) -> None:
    """Log the outline of each image in the other one, warped by a homography.

    Args:
        H: (3, 3), pixels of image 1 to pixels of image 2.
        sizes_wh: sizes of the two images, pixels.
    """
    H = np.asarray(H, dtype=np.float64)
    for number, A in ((1, np.linalg.inv(H)), (2, H)):
        outline = marks.warped_outline(A, sizes_wh[2 - number])
        if outline is not None:
            strip = rr.LineStrips2D(
                [outline],
                colors=MAGENTA,
                radii=rr.Radius.ui_points(1.5),
                labels=f"image {3 - number}, warped",
                show_labels=True,
            )
            put(rec, prefix, f"world/cam{number}/image/homography", strip, stage="estimate")


def log_pose(rec: rr.RecordingStream, R: Any, t: Any = None, *, prefix: str = "") -> None:
    """Log the pose of camera 2 and the baseline.

    Args:
        R, t: ``X2 = R X1 + t``; without t the camera only rotated and there is no baseline.
    """
    R = np.asarray(R, dtype=np.float64)
    put(rec, prefix, "world/cam2", _place(R, np.zeros(3) if t is None else t), stage="pose")
    if t is not None:
        arrow = rr.Arrows3D(
            origins=[[0, 0, 0]],
            vectors=[-R.T @ np.asarray(t)],
            colors=MAGENTA,
            radii=rr.Radius.ui_points(1),
            labels="baseline: length 1",
            show_labels=False,
        )
        put(rec, prefix, "world/baseline", arrow, stage="pose")


def log_motion(
    rec: rr.RecordingStream,
    E: Any,
    x1: Any,
    x2: Any,
    cameras: Cameras,
    *,
    pose: tuple[Any, Any] | None = None,
    frustum: float = 0.5,
    prefix: str = "",
) -> tuple[int, int, int, int]:
    """Log the four poses of an essential matrix and their cheirality, and the chosen pose.

    Args:
        E: (3, 3) essential matrix.
        x1, x2: (N, 2) pixels without distortion.
        cameras: intrinsics of both images.
        pose: (R, t) to mark as chosen; default the pose with most points in front of both cameras.
        frustum: size of the drawn cameras, baselines.

    Returns:
        For each of the four poses, the number of points in front of both cameras.

    Raises:
        InputError: arrays of another shape.
    """
    a = points_2d("x1", x1)
    (K1, _), (K2, _) = cameras[0].tensors(), cameras[1].tensors()
    xn1 = normalize(torch.as_tensor(a), K1)
    xn2 = normalize(torch.as_tensor(points_2d("x2", x2, len(a))), K2)
    E = torch.as_tensor(np.asarray(E), dtype=torch.float64)
    poses = list(zip(*decompose_essential(E)))
    counts = [int(cheirality(xn1, xn2, R, t).sum()) for R, t in poses]
    if pose is None:
        pose = poses[int(np.argmax(counts))]
    chosen_R, chosen_t = (torch.as_tensor(np.asarray(p), dtype=torch.float64) for p in pose)
    for number, ((R, t), in_front) in enumerate(zip(poses, counts), start=1):
        off = float((R - chosen_R).abs().max()) + float((t - chosen_t).abs().max())
        _log_candidate(rec, number, R, t, cameras[1], in_front, off < _SAME_POSE, frustum, prefix)
    log_pose(rec, chosen_R, chosen_t, prefix=prefix)
    return counts[0], counts[1], counts[2], counts[3]


def label_height(number: int, frustum: float) -> float:
    """Height of the label of pose 1 to 4 above the centre of its camera, baselines."""
    return (0.9 + 0.45 * number) * frustum


def _log_candidate(
    rec: rr.RecordingStream,
    number: int,
    R: Any,
    t: Any,
    camera: Camera,
    in_front: int,
    chosen: bool,
    frustum: float,
    prefix: str,
) -> None:
    """One of the four poses: its camera, and the number of points in front."""
    colour, at = GREEN if chosen else GREY, f"world/poses/{number}"
    put(rec, prefix, at, _place(R, t), stage="pose")
    put(rec, prefix, f"{at}/frustum", pinhole(camera, frustum, color=colour), stage="pose")
    # Two of the poses share a centre, so every label gets its own height above it, in the frame of
    # camera 1: two of the poses are upside down.
    stem = R.numpy() @ [0, -label_height(number, frustum), 0]
    line = rr.LineStrips3D([[[0, 0, 0], stem]], colors=colour, radii=rr.Radius.ui_points(0.5))
    put(rec, prefix, f"{at}/stem", line, stage="pose")
    dot = rr.Points3D(
        [stem],
        colors=colour,
        radii=rr.Radius.ui_points(5),
        labels=f"pose {number}: {in_front:,}",
        show_labels=True,
    )
    own = columns(in_front=[in_front], chosen=[chosen])
    put(rec, prefix, f"{at}/count", dot, own, stage="pose")


def _place(R: Any, t: Any) -> rr.Transform3D:
    """The pose of a camera, camera from world."""
    return rr.Transform3D(
        mat3x3=np.asarray(R),
        translation=np.asarray(t),
        relation=rr.TransformRelation.ChildFromParent,
    )
