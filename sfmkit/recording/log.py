"""Log whole reconstructions. docs/recording.md describes the schema.

Every ``log_*`` function takes an explicit stream and a prefix for the entity paths. It sets the
timeline ``stage`` and no other, so results can be logged at any time of the caller's own timelines.

All pixels are those of ideal pinholes: where a camera has distortion, photographs and keypoints are
undistorted with the same K, so that epipolar lines are straight and the cloud projects onto the
photographs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from matplotlib import colormaps

from .._utils.labels import label
from .._utils.writing import atomic_write
from ..geometry.fundamental import fundamental_from_essential
from ..geometry.reprojection import project
from ..pipeline.account import ALL, OperatorAccount
from ..pipeline.reconstruction import Reconstruction
from ..pipeline.report import make_report
from ..pipeline.stages import name_of
from ..types import PointCloud, TwoView, Verdict
from ..viz.colours import operator_rgb
from . import marks, text
from .blueprint import QUANTITIES, default_blueprint
from .eye import frustum_size
from .log_cloud import log_cloud, log_rays, log_residuals, log_uncertainty, operator_colours
from .log_geometry import log_epipolar_lines, log_homography, log_motion, log_pose
from .log_photos import (
    log_correspondences,
    log_keypoints,
    log_matches,
    log_photographs,
    side_by_side,
)
from .log_steps import log_ransac
from .read import SCHEMA
from .scales import log_legend
from .stream import STAGES, columns, drain, new_stream, put
from .trace import Trace, matches_to_rows, trace, trace_keypoints

MAX_SURVIVORS = 2500  # dots of an image at one stage; more hide the photograph
MAX_CURRENT = 150  # lines of the matches at one stage


def save_recording(
    path: str | Path,
    result: Reconstruction,
    *,
    originals: bool = False,
) -> None:
    """Write a whole reconstruction, with the layout of its views, to one .rrd file.

    Args:
        path: appears whole or not at all; an existing file is replaced.
        originals: keep the photographs as they are (the file's own JPEG, or PNG) instead of at JPEG
            quality 80.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary:
        rec = new_stream(label(Path(path).stem))
        try:
            rec.send_recording_name(
                " + ".join(name_of(image, n) for n, image in enumerate(result.images, start=1))
            )
            log_reconstruction(rec, result, originals=originals)
            temporary.write_bytes(drain(rec, default_blueprint(result)))
        finally:
            rec.disconnect()


def log_reconstruction(
    rec: rr.RecordingStream,
    result: Reconstruction,
    prefix: str = "",
    *,
    originals: bool = False,
) -> None:
    """Log everything of a reconstruction, stage by stage.

    Args:
        originals: as in :func:`save_recording`.
    """
    view, corr, cloud = result.two_view, result.correspondences, result.cloud
    cameras = (view.camera1, view.camera2)
    traced = trace(corr, view, cloud, result.options.estimate.threshold_px)
    frustum = frustum_size(result)
    for stage, words in text.story(result).items():
        put(rec, prefix, "story", _markdown(words), stage=stage)
    log_legend(rec, corr.operators, prefix)
    _log_notes(rec, result, prefix)
    log_photographs(
        rec, *result.images, cameras, originals=originals, frustum=frustum, prefix=prefix
    )
    _log_features(rec, result, traced, prefix)
    _log_fusion(rec, result, prefix)
    x1, x2 = (marks.ideal_pixels(x, c) for x, c in zip((corr.x1, corr.x2), cameras))
    if view.history:
        K1, K2 = cameras[0].tensors()[0], cameras[1].tensors()[0]
        fundamental = result.options.estimate.model == "fundamental"
        log_ransac(
            rec,
            [
                h.model if fundamental else fundamental_from_essential(h.model, K1, K2)
                for h in view.history
            ],
            [h.inliers for h in view.history],
            x1,
            x2,
            sizes_wh=(cameras[0].size_wh, cameras[1].size_wh),
            scores=[h.score for h in view.history],
            steps=[h.stage for h in view.history],
            samples=[h.iteration for h in view.history],
            prefix=prefix,
        )
    _log_two_view(rec, result, traced, frustum, prefix)
    if cloud is not None and len(cloud):
        _log_points(rec, result, prefix)
        if cloud.covariance is not None:
            log_uncertainty(rec, cloud, details=_pixel_columns(result), prefix=prefix)
        _log_example(rec, result, marks.example_point(cloud), prefix)
    log_account(rec, result.account, prefix)
    log_timings(rec, result.timings_s, prefix)
    put(rec, prefix, "summary", _markdown(text.report_markdown(result)))
    put(rec, prefix, "verdict", _markdown(text.verdict_markdown(view)), stage="estimate")
    report = json.dumps({"schema": SCHEMA, **make_report(result)}, indent=1)
    put(rec, prefix, "report", rr.TextDocument(report, media_type="text/plain"))


def log_run(
    rec: rr.RecordingStream,
    result: Reconstruction,
    run: int,
    prefix: str = "",
    *,
    images: bool = True,
) -> None:
    """Log one of several reconstructions of the same pair, at `run` on the timeline ``run``.

    Args:
        images: log the photographs too; once per pair is enough.
    """
    rec.set_time("run", sequence=run)
    view, corr, cloud = result.two_view, result.correspondences, result.cloud
    traced = trace(corr, view, cloud, result.options.estimate.threshold_px)
    if images:
        log_photographs(rec, *result.images, (view.camera1, view.camera2), prefix=prefix)
    log_legend(rec, corr.operators, prefix)
    put(rec, prefix, "world", rr.Clear(recursive=True), stage="estimate")
    put(rec, prefix, "matches", rr.Clear(recursive=True), stage="estimate")
    _log_two_view(rec, result, traced, 0.5, prefix)
    if cloud is not None and len(cloud):
        _log_points(rec, result, prefix)
    words = f"# run {run}: {', '.join(corr.operators)}\n\n{text.report_markdown(result)}"
    put(rec, prefix, "summary", _markdown(words), stage=STAGES[-1])
    rec.disable_timeline("run")


def log_account(
    rec: rr.RecordingStream, account: Mapping[str, OperatorAccount], prefix: str = ""
) -> None:
    """Log the per-operator statistics as a table, and as one chart of bars per quantity.

    The quantities are keypoints of image 1, matches, fused, inliers and points.
    """
    put(rec, prefix, "account/table", _markdown(text.account_markdown(account)))
    for k, name in enumerate(name for name in account if name != ALL):
        a = account[name]
        counts = (a.keypoints[0], a.matches, a.initial, a.inliers, a.points)
        for quantity, count in zip(QUANTITIES, counts):
            bar = rr.BarChart(np.array([count]), abscissa=np.array([k]), color=operator_rgb(name))
            put(rec, prefix, ["account/chart", quantity, name], bar)


def log_timings(rec: rr.RecordingStream, timings_s: Mapping[str, float], prefix: str = "") -> None:
    """Log the seconds of each stage, one bar per stage, at the stage's number."""
    for stage, seconds in timings_s.items():
        if stage not in STAGES:
            continue
        k = STAGES.index(stage)
        colour = tuple(int(255 * c) for c in colormaps["cividis"](k / 7)[:3])
        chart = rr.BarChart(np.array([seconds]), abscissa=np.array([k]), color=colour)
        put(rec, prefix, ["timings", stage], chart)


def log_fusion(
    rec: rr.RecordingStream,
    features: Mapping[str, Any],
    matches: Mapping[str, Any],
    corr: Any,
    *,
    cameras: Any = None,
    prefix: str = "",
) -> None:
    """Log the matches that fusion merged into another one, by operator.

    Args:
        features: operator -> features of both images.
        matches: operator -> matches before fusion.
        corr: fused correspondences.
        cameras: their distortion is removed from the pixels.
    """
    kept_by = np.array(corr.operators, dtype=str)[corr.operator_id.numpy()]
    for name, (rows, merged) in matches_to_rows(features, matches, corr).items():
        if merged.any():
            (f1, f2), m, into = features[name], matches[name], rows[merged]
            log_matches(
                rec,
                f1.keypoints[m.index1[merged]],
                f2.keypoints[m.index2[merged]],
                width1=f1.size_wh[0],
                operator=name,
                kind="merged",
                cameras=cameras,
                details={"match": into, "merged_into": kept_by[into]},
                prefix=prefix,
            )


def _log_features(
    rec: rr.RecordingStream, result: Reconstruction, traced: Trace, prefix: str
) -> None:
    """Keypoints and matches of every operator, and what is left of them."""
    view = result.two_view
    cameras = (view.camera1, view.camera2)
    became = trace_keypoints(result.features, result.matches, result.correspondences, traced)
    for number, camera in enumerate(cameras, start=1):
        left = []
        for name, pair in result.features.items():
            f, b = pair[number - 1], became[name][number - 1]
            if len(f):
                own = {
                    "fate": b.fate,
                    "match": b.match,
                    "point": b.point,
                    "partner": b.partner,
                    "descriptor_distance": b.distance,
                    "descriptor_ratio": b.ratio,
                }
                log_keypoints(
                    rec, number, f, operator=name, camera=camera, details=own, prefix=prefix
                )
                left.append((name, marks.ideal_pixels(f.keypoints, camera)))
        _log_survivors(rec, number, left, "detect", prefix)
    left1, left2 = [], []
    for name, m in result.matches.items():
        if len(m):
            f1, f2 = result.features[name]
            log_matches(rec, f1, f2, m, operator=name, cameras=cameras, prefix=prefix)
            left1.append((name, marks.ideal_pixels(f1.keypoints[m.index1], cameras[0])))
            left2.append((name, marks.ideal_pixels(f2.keypoints[m.index2], cameras[1])))
    _log_survivors(rec, 1, left1, "match", prefix)
    _log_survivors(rec, 2, left2, "match", prefix)
    if left1:
        names = np.array([name for name, x in left1 for _ in x], dtype=str)
        x1, x2 = (np.concatenate([x for _, x in left]) for left in (left1, left2))
        _log_current(rec, result, (x1, x2), names, "match", prefix)


def _log_fusion(rec: rr.RecordingStream, result: Reconstruction, prefix: str) -> None:
    corr, view = result.correspondences, result.two_view
    cameras = (view.camera1, view.camera2)
    log_fusion(rec, result.features, result.matches, corr, cameras=cameras, prefix=prefix)
    places = tuple(marks.ideal_pixels(x, c) for x, c in zip((corr.x1, corr.x2), cameras))
    for number, x in enumerate(places, start=1):
        _log_survivors(rec, number, _by_operator(result, x), "fuse", prefix)
    kept_by = np.array(corr.operators, dtype=str)[corr.operator_id.numpy()]
    _log_current(rec, result, places, kept_by, "fuse", prefix)
    inliers = view.inliers.numpy()
    agreeing = (places[0][inliers], places[1][inliers])
    _log_current(rec, result, agreeing, kept_by[inliers], "estimate", prefix)


def _log_two_view(
    rec: rr.RecordingStream, result: Reconstruction, traced: Trace, frustum: float, prefix: str
) -> None:
    """Inliers and outliers by operator, and the geometry they agree on."""
    corr, view = result.correspondences, result.two_view
    cameras = (view.camera1, view.camera2)
    sizes = (cameras[0].size_wh, cameras[1].size_wh)
    x1, x2 = (marks.ideal_pixels(x, c) for x, c in zip((corr.x1, corr.x2), cameras))
    inliers, operator_id = view.inliers.numpy(), corr.operator_id.numpy()
    own = _match_columns(result, traced)
    log_correspondences(
        rec, corr, inliers, width1=sizes[0][0], cameras=cameras, details=own, prefix=prefix
    )
    for number, x in ((1, x1), (2, x2)):
        _log_survivors(rec, number, _by_operator(result, x, inliers), "estimate", prefix)
    if view.F is not None and inliers.any():
        rows = np.flatnonzero(inliers)
        rows = rows[marks.spread(x1[rows], 12)]
        kept_by = np.array(corr.operators, dtype=str)[operator_id]
        log_epipolar_lines(
            rec,
            view.F,
            x1,
            x2,
            sizes_wh=sizes,
            rows=rows,
            details={"operators": kept_by},
            prefix=prefix,
        )
    if view.H is not None and view.verdict in (Verdict.PLANAR, Verdict.PURE_ROTATION):
        log_homography(rec, view.H, sizes_wh=sizes, prefix=prefix)
    if view.R is not None and view.t is not None and view.E is not None:
        log_motion(
            rec,
            view.E,
            x1[inliers],
            x2[inliers],
            cameras,
            pose=(view.R, view.t),
            frustum=frustum,
            prefix=prefix,
        )
    elif view.R is not None:
        log_pose(rec, view.R, view.t, prefix=prefix)


def _log_points(rec: rr.RecordingStream, result: Reconstruction, prefix: str) -> None:
    """The cloud, and the residuals in both images."""
    corr, view, cloud = result.correspondences, result.two_view, result.cloud
    assert cloud is not None
    own = _pixel_columns(result)
    log_cloud(rec, cloud, details=own, prefix=prefix)
    colours = operator_colours(_kept_by(cloud))
    for number, (camera, x, pose) in enumerate(
        ((view.camera1, corr.x1, (None, None)), (view.camera2, corr.x2, (view.R, view.t))), start=1
    ):
        seen = marks.ideal_pixels(x[cloud.match], camera)
        projected = project(cloud.xyz, camera.tensors()[0], *pose).numpy()
        log_residuals(rec, number, seen, projected, colours=colours, prefix=prefix)
        _log_survivors(rec, number, [], "triangulate", prefix)  # the projected cloud is shown


def _log_example(rec: rr.RecordingStream, result: Reconstruction, point: int, prefix: str) -> None:
    """The rays and the pixels of one point."""
    corr, view, cloud = result.correspondences, result.two_view, result.cloud
    assert cloud is not None
    row = int(cloud.match[point])
    log_rays(
        rec,
        cloud.xyz[point : point + 1],
        _centre2(view),
        x1=marks.ideal_pixels(corr.x1[row][None], view.camera1),
        x2=marks.ideal_pixels(corr.x2[row][None], view.camera2),
        names=[f"point {point:,}"],
        details={"point": [point], "match": [row]},
        operators=[_kept_by(cloud)[point]],
        prefix=prefix,
    )


def _log_survivors(
    rec: rr.RecordingStream,
    number: int,
    left: Sequence[tuple[str, np.ndarray]],
    stage: str,
    prefix: str,
) -> None:
    """What is left at a stage in one image, an even sample; the next stage replaces it."""
    total = sum(len(x) for _, x in left)
    share = min(1.0, MAX_SURVIVORS / max(total, 1))
    shown = [(name, x[marks.spread(x, int(np.ceil(share * len(x))))]) for name, x in left]
    x = np.concatenate([x for _, x in shown]) if shown else np.zeros((0, 2))
    colours = operator_colours([name for name, x in shown for _ in x])
    dots = rr.Points2D(x, colors=colours, radii=rr.Radius.ui_points(1.5))
    put(rec, prefix, f"world/cam{number}/image/survivors", dots, columns(of=[total]), stage=stage)


def _log_current(
    rec: rr.RecordingStream,
    result: Reconstruction,
    x: tuple[np.ndarray, np.ndarray],
    names: np.ndarray,
    stage: str,
    prefix: str,
) -> None:
    """A sample of the matches at a stage, side by side; the next stage replaces it."""
    # In a random order, because the sample takes the first matches of every cell.
    order = np.random.default_rng(0).permutation(len(names))
    some = order[marks.spread(x[0][order], MAX_CURRENT)]
    width1 = result.two_view.camera1.size_wh[0]
    lines = side_by_side(x[0][some], x[1][some], width1, operator_colours(names[some]))
    put(rec, prefix, "matches/current", lines, stage=stage)


def _log_notes(rec: rr.RecordingStream, result: Reconstruction, prefix: str) -> None:
    """Log what is missing in the views that are empty at the first stages."""
    (w, h), size = result.two_view.camera1.size_wh, rr.Radius.ui_points(1)
    for at, what, until in (
        ("matches/current/note", "matches", "match"),
        ("matches/tentative/note", "matches", "match"),
        ("matches/merged/note", "merged matches", "fuse"),
        ("matches/inliers/note", "inliers", "estimate"),
        ("matches/outliers/note", "outliers", "estimate"),
        ("world/note", "pose", "pose"),
        ("world/points/note", "points", "triangulate"),
    ):
        kind, place = (rr.Points3D, [0, 0, 1]) if at[0] == "w" else (rr.Points2D, [w, h / 2])
        note = f"no {what} before stage {STAGES.index(until)}"
        mark = kind([place], radii=size, labels=note, show_labels=True, colors=(40, 40, 40))
        put(rec, prefix, at, mark, stage="read")
        put(rec, prefix, at, kind(np.zeros((0, len(place)))), stage=until)


def _by_operator(
    result: Reconstruction, x: np.ndarray, chosen: np.ndarray | None = None
) -> list[tuple[str, np.ndarray]]:
    corr = result.correspondences
    operator_id = corr.operator_id.numpy()
    keep = np.ones(len(x), dtype=bool) if chosen is None else chosen
    return [(name, x[keep & (operator_id == k)]) for k, name in enumerate(corr.operators)]


def _match_columns(result: Reconstruction, traced: Trace) -> dict[str, Any]:
    """Columns of all correspondences."""
    corr = result.correspondences
    return {
        "match": np.arange(len(corr)),
        "operators": traced.operators,
        "fate": traced.fate,
        "distance_px": traced.distance_px,
        "point": traced.point,
        "x1": corr.x1.numpy(),
        "x2": corr.x2.numpy(),
        "keypoint1": corr.index1.numpy(),
        "keypoint2": corr.index2.numpy(),
        "descriptor_distance": corr.distance.numpy(),
        "descriptor_ratio": corr.ratio.numpy(),
    }


def _pixel_columns(result: Reconstruction) -> dict[str, Any]:
    """Pixels and keypoints behind every point of the cloud."""
    corr, cloud = result.correspondences, result.cloud
    assert cloud is not None
    rows = cloud.match
    return {
        "x1": corr.x1[rows].numpy(),
        "x2": corr.x2[rows].numpy(),
        "keypoint1": corr.index1[rows].numpy(),
        "keypoint2": corr.index2[rows].numpy(),
    }


def _kept_by(cloud: PointCloud) -> list[str]:
    return [cloud.operators[k] for k in cloud.operator_id.tolist()]


def _centre2(view: TwoView) -> np.ndarray:
    if view.R is None or view.t is None:
        return np.zeros(3)
    return -(view.R.T @ view.t).numpy()


def _markdown(words: str) -> rr.TextDocument:
    return rr.TextDocument(label(words), media_type="text/markdown")
