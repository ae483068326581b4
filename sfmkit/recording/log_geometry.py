"""What the geometry is: epipolar lines, poses, the cloud, and how sure it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from matplotlib import colormaps

from ..geometry.coordinates import normalize
from ..geometry.essential import decompose_essential
from ..geometry.fundamental import epipolar_lines, epipoles, fundamental_from_essential
from ..geometry.pose import cheirality
from ..geometry.reprojection import project
from ..types import Correspondences, Improvement, PointCloud, TwoView, Verdict
from . import marks
from .stream import (
    GREY,
    MAGENTA,
    Cameras,
    columns,
    dot_radius,
    log_survivors,
    pinhole,
    put,
    ramp,
    side_by_side,
    strokes,
)
from .trace import Trace, joined_names

RESIDUAL_GAIN = 50  # residuals are drawn this many times longer than they are
SIGMAS = 3  # of the drawn ellipsoids


def log_history(
    rec: rr.RecordingStream,
    history: Sequence[Improvement],
    corr: Correspondences,
    cameras: Cameras,
    prefix: str = "",
    *,
    kind: str = "essential",
    sample: int = 12,
) -> None:
    """How the robust estimate improved, on the timeline ``iteration``: counts, and lines swinging
    into place.

    The timeline counts improvements: several may have come of the same number of samples, which are
    logged beside them.

    Args:
        history: :attr:`sfmkit.types.TwoView.history`.
        kind: what its models are: ``essential`` (normalised coordinates) or ``fundamental``
            (pixels).
        sample: number of matches whose lines are drawn.
    """
    if not history:
        return
    (K1, _), (K2, _) = cameras[0].tensors(), cameras[1].tensors()
    rows = marks.spread(corr.x1.numpy(), sample)
    for quantity, name in (("inliers", "inliers"), ("score", "mean score a match")):
        put(
            rec,
            prefix,
            f"estimation/{quantity}",
            rr.SeriesLines(names=name, interpolation_mode="StepAfter"),
        )
    for number, step in enumerate(history):
        rec.set_time("iteration", sequence=number)
        F = step.model if kind == "fundamental" else fundamental_from_essential(step.model, K1, K2)
        put(
            rec,
            prefix,
            "estimation/inliers",
            rr.Scalars(step.inliers),
            columns(step=[step.stage], samples=[step.iteration]),
            stage="estimate",
        )
        put(rec, prefix, "estimation/score", rr.Scalars(step.score), stage="estimate")
        _log_epipolar(rec, corr, cameras, F, rows, prefix)
    rec.disable_timeline("iteration")
    counts = np.array([step.inliers for step in history])
    put(rec, prefix, "estimation/improvements", rr.BarChart(counts, color=GREY))


def log_two_view(
    rec: rr.RecordingStream,
    corr: Correspondences,
    view: TwoView,
    traced: Trace,
    prefix: str = "",
    *,
    sample: int = 12,
    max_lines: int = 80,
) -> None:
    """Inliers and outliers by operator, epipolar lines and epipoles; where a homography is the
    model, its outline.

    Args:
        traced: what became of every correspondence (:func:`sfmkit.recording.trace.trace`).
        sample: number of inliers whose epipolar lines are drawn.
        max_lines: lines drawn side by side an operator, for inliers and for outliers.
    """
    cameras = (view.camera1, view.camera2)
    x = tuple(marks.ideal_pixels(p, c) for p, c in zip((corr.x1, corr.x2), cameras))
    inliers, operator_id = view.inliers.numpy(), corr.operator_id.numpy()
    for what, chosen in (("inliers", inliers), ("outliers", ~inliers)):
        colour = {} if what == "inliers" else {"colors": GREY}
        for k, name in enumerate(corr.operators):
            rows = np.flatnonzero(chosen & (operator_id == k))
            if not len(rows):
                continue
            for number in (1, 2):
                dots = rr.Points2D(
                    x[number - 1][rows], class_ids=k, radii=rr.Radius.ui_points(1), **colour
                )
                at = [f"world/cam{number}/image", what, name]
                put(rec, prefix, at, dots, _match_columns(corr, traced, rows), stage="estimate")
            some = rows[marks.spread(x[0][rows], max_lines)]
            lines = side_by_side(x[0][some], x[1][some], cameras, class_ids=k)
            put(
                rec,
                prefix,
                ["matches", what, name],
                lines,
                _match_columns(corr, traced, some),
                stage="estimate",
            )
    for number in (1, 2):
        log_survivors(
            rec, prefix, number, [(x[number - 1][inliers], operator_id[inliers])], "estimate"
        )
    if view.F is not None and inliers.any():
        rows = np.flatnonzero(inliers)
        _log_epipolar(rec, corr, cameras, view.F, rows[marks.spread(x[0][rows], sample)], prefix)
        for number, e in enumerate(epipoles(view.F), start=1):
            if abs(float(e[2])) > 1e-12:
                dot = rr.Points2D(
                    (e[:2] / e[2]).numpy()[None],
                    colors=MAGENTA,
                    radii=rr.Radius.ui_points(6),
                    labels=f"epipole: camera {3 - number}",
                    show_labels=True,
                )
                put(rec, prefix, f"world/cam{number}/image/epipole", dot, stage="estimate")
    if view.H is not None and view.verdict in (Verdict.PLANAR, Verdict.PURE_ROTATION):
        H = view.H.numpy()
        for number, (A, camera) in enumerate(
            ((np.linalg.inv(H), view.camera2), (H, view.camera1)), start=1
        ):
            outline = marks.warped_outline(A, camera.size_wh)
            if outline is not None:
                strip = rr.LineStrips2D(
                    [outline],
                    colors=MAGENTA,
                    radii=rr.Radius.ui_points(1.5),
                    labels=f"image {3 - number}, warped",
                    show_labels=True,
                )
                put(rec, prefix, f"world/cam{number}/image/homography", strip, stage="estimate")


def log_pose(
    rec: rr.RecordingStream,
    corr: Correspondences,
    view: TwoView,
    prefix: str = "",
    *,
    frustum: float = 0.5,
) -> None:
    """Where camera 2 stands, and the four poses that E allows with the number of points in front of
    both cameras."""
    if view.R is None:
        return
    place = {"relation": rr.TransformRelation.ChildFromParent}
    t = np.zeros(3) if view.t is None else view.t.numpy()
    put(
        rec,
        prefix,
        "world/cam2",
        rr.Transform3D(mat3x3=view.R.numpy(), translation=t, **place),
        stage="pose",
    )
    if view.t is None or view.E is None:
        return
    centre = -view.R.numpy().T @ t
    put(
        rec,
        prefix,
        "world/baseline",
        rr.Arrows3D(
            origins=[[0, 0, 0]],
            vectors=[centre],
            colors=MAGENTA,
            radii=rr.Radius.ui_points(1),
            labels="baseline: length 1",
            show_labels=False,
        ),
        stage="pose",
    )
    (K1, _), (K2, _) = view.camera1.tensors(), view.camera2.tensors()
    rows = view.inliers
    x1, x2 = (
        marks.ideal_pixels(p, c) for p, c in zip((corr.x1, corr.x2), (view.camera1, view.camera2))
    )
    xn1, xn2 = (
        normalize(rows.new_tensor(p, dtype=K1.dtype)[rows], K) for p, K in ((x1, K1), (x2, K2))
    )
    total = int(rows.sum())
    for number, (R, s) in enumerate(zip(*decompose_essential(view.E)), start=1):
        chosen = float((R - view.R).abs().max()) + float((s - view.t).abs().max()) < 1e-3
        in_front = int(cheirality(xn1, xn2, R, s).sum())
        colour = (0, 158, 115) if chosen else GREY
        at = f"world/poses/{number}"
        put(
            rec,
            prefix,
            at,
            rr.Transform3D(mat3x3=R.numpy(), translation=s.numpy(), **place),
            stage="pose",
        )
        put(
            rec, prefix, f"{at}/frustum", pinhole(view.camera2, frustum, color=colour), stage="pose"
        )
        label = f"pose {number}: {in_front:,} of {total:,} in front" + (
            " (chosen)" if chosen else ""
        )
        dot = rr.Points3D(
            [[0, 0, frustum]],
            colors=colour,
            radii=rr.Radius.ui_points(5),
            labels=label,
            show_labels=True,
        )
        put(
            rec,
            prefix,
            f"{at}/count",
            dot,
            columns(in_front=[in_front], chosen=[chosen]),
            stage="pose",
        )


def log_cloud(
    rec: rr.RecordingStream,
    cloud: PointCloud,
    corr: Correspondences,
    view: TwoView,
    prefix: str = "",
) -> None:
    """The cloud in its colours, by operator and by density, and the residuals in the images (50
    times longer)."""
    k = cloud.operator_id.numpy()
    details = _point_columns(cloud, corr)
    xyz = cloud.xyz.numpy()
    for name, colours in (
        ("photograph", {"colors": cloud.rgb.numpy()}),
        ("operator", {}),
        ("density", {"colors": ramp(np.log(marks.neighbour_density(xyz)))}),
    ):
        dots = rr.Points3D(xyz, class_ids=k, radii=dot_radius(len(cloud)), **colours)
        put(rec, prefix, f"world/points/{name}", dots, details, stage="triangulate")
    for number, (camera, x, pose) in enumerate(
        ((view.camera1, corr.x1, (None, None)), (view.camera2, corr.x2, (view.R, view.t))), start=1
    ):
        seen = marks.ideal_pixels(x[cloud.match], camera)
        error = project(cloud.xyz, camera.tensors()[0], *pose).numpy() - seen
        arrows = strokes(np.stack([seen, seen + RESIDUAL_GAIN * error], 1), class_ids=k, width=0.8)
        size = columns(residual_px=np.linalg.norm(error, axis=1), point=np.arange(len(cloud)))
        put(rec, prefix, f"world/cam{number}/image/residuals", arrows, size, stage="triangulate")
        log_survivors(rec, prefix, number, [], "triangulate")  # the cloud, projected, takes over


def log_uncertainty(
    rec: rr.RecordingStream,
    cloud: PointCloud,
    corr: Correspondences,
    prefix: str = "",
    *,
    sample: int = 200,
) -> None:
    """The cloud by its uncertainty, and 3-sigma ellipsoids of a sample; nothing where the cloud has
    no covariance."""
    if cloud.covariance is None:
        return
    covariance, k, xyz = cloud.covariance.numpy(), cloud.operator_id.numpy(), cloud.xyz.numpy()
    sigma = marks.largest_sigma(covariance)
    dots = rr.Points3D(
        xyz,
        class_ids=k,
        colors=ramp(np.log(np.maximum(sigma, 1e-12))),
        radii=dot_radius(len(cloud)),
    )
    put(rec, prefix, "world/points/uncertainty", dots, _point_columns(cloud, corr), stage="refine")
    some = marks.spread(xyz[:, :2] / xyz[:, 2:], sample)
    half_sizes, quaternions = marks.ellipsoids(covariance[some], SIGMAS)
    shells = rr.Ellipsoids3D(
        centers=xyz[some],
        half_sizes=half_sizes,
        quaternions=quaternions,
        class_ids=k[some],
        line_radii=rr.Radius.ui_points(0.5),
        show_labels=False,
    )
    put(
        rec,
        prefix,
        "world/ellipsoids",
        shells,
        columns(point=some, sigma=sigma[some]),
        stage="refine",
    )


def log_match(
    rec: rr.RecordingStream,
    row: int,
    corr: Correspondences,
    view: TwoView,
    cloud: PointCloud,
    prefix: str = "",
) -> None:
    """One correspondence in both images and in space: its pixels, and the two rays that meet in its
    point."""
    point = int((cloud.match == row).nonzero()[0])
    X = cloud.xyz[point].numpy()
    centre2 = np.zeros(3) if view.R is None or view.t is None else -(view.R.T @ view.t).numpy()
    rays = rr.LineStrips3D(
        [[[0, 0, 0], X], [centre2, X]],
        class_ids=int(cloud.operator_id[point]),
        radii=rr.Radius.ui_points(1.2),
        show_labels=False,
    )
    put(rec, prefix, "world/rays", rays, columns(point=[point], match=[row]), stage="triangulate")
    for number, (x, camera) in enumerate(
        ((corr.x1, view.camera1), (corr.x2, view.camera2)), start=1
    ):
        dot = rr.Points2D(
            marks.ideal_pixels(x[row][None], camera),
            class_ids=int(corr.operator_id[row]),
            radii=rr.Radius.ui_points(5),
            labels=f"point {point:,}",
            show_labels=True,
        )
        put(
            rec,
            prefix,
            f"world/cam{number}/image/chosen",
            dot,
            columns(match=[row], point=[point]),
            stage="triangulate",
        )


def _match_columns(corr: Correspondences, traced: Trace, rows: np.ndarray) -> rr.DynamicArchetype:
    return columns(
        match=rows,
        operators=traced.operators[rows],
        fate=traced.fate[rows],
        distance_px=traced.distance_px[rows],
        point=traced.point[rows],
        x1=corr.x1.numpy()[rows],
        x2=corr.x2.numpy()[rows],
        descriptor_distance=corr.distance.numpy()[rows],
        descriptor_ratio=corr.ratio.numpy()[rows],
    )


def _point_columns(cloud: PointCloud, corr: Correspondences) -> rr.DynamicArchetype:

    rows = cloud.match
    details = {
        "point": np.arange(len(cloud)),
        "match": rows.numpy(),
        "operators": joined_names(cloud.operator_mask.numpy(), cloud.operators),
        "operator_mask": cloud.operator_mask.numpy(),
        "x1": corr.x1[rows].numpy(),
        "x2": corr.x2[rows].numpy(),
        "keypoint1": corr.index1[rows].numpy(),
        "keypoint2": corr.index2[rows].numpy(),
        "residual_px": cloud.reprojection_error.numpy(),
        "parallax_deg": cloud.parallax.numpy(),
    }
    if cloud.covariance is not None:
        details["sigma"] = marks.largest_sigma(cloud.covariance.numpy())
    return columns(**details)


def _log_epipolar(
    rec: rr.RecordingStream,
    corr: Correspondences,
    cameras: Cameras,
    F: Any,
    rows: np.ndarray,
    prefix: str,
) -> None:
    """The epipolar lines of some correspondences in both images, and their points; the same number,
    the same match."""
    x1, x2 = (marks.ideal_pixels(x[rows], c) for x, c in zip((corr.x1, corr.x2), cameras))
    colours = (colormaps["turbo"](np.linspace(0.05, 0.95, len(rows)))[:, :3] * 255).astype(np.uint8)
    for number, (mine, other, A) in enumerate(((x1, x2, F.mT), (x2, x1, F)), start=1):
        at = f"world/cam{number}/image/epipolar"
        segments, crossing = marks.clip_lines(
            epipolar_lines(A, F.new_tensor(other)).numpy(), cameras[number - 1].size_wh
        )
        lines = strokes(segments, colors=colours[crossing], width=1)
        put(rec, prefix, f"{at}/lines", lines, columns(match=rows[crossing]), stage="estimate")
        dots = rr.Points2D(
            mine,
            colors=colours,
            radii=rr.Radius.ui_points(4),
            show_labels=True,
            labels=[str(n + 1) for n in range(len(rows))],
        )
        details = columns(
            match=rows, operators=np.array(corr.operators)[corr.operator_id.numpy()[rows]]
        )
        put(rec, prefix, f"{at}/points", dots, details, stage="estimate")
