"""Recordings for the Rerun viewer: what is logged, where and when. The schema is described in
docs/recording.md.

Every ``log_*`` function takes a stream, results of the library and a prefix for the entity paths,
sets the timeline ``stage`` itself and leaves all other timelines of the stream alone, so that
results can be logged under a time of the caller's choosing (see :func:`log_run`).

All pixels are those of ideal pinholes: where a camera has distortion, the photographs and keypoints
are undistorted (same K), so that epipolar lines are straight and the cloud projects onto the
photographs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from matplotlib import colormaps

from .._utils.writing import atomic_write
from ..errors import OutputError
from ..pipeline.account import ALL, OperatorAccount
from ..pipeline.reconstruction import Reconstruction, name_of
from ..pipeline.report import make_report
from ..viz.colours import operator_rgb
from . import marks, text
from .blueprint import default_blueprint
from .log_geometry import (
    log_cloud,
    log_history,
    log_match,
    log_pose,
    log_two_view,
    log_uncertainty,
)
from .log_photos import log_features, log_fusion, log_images, log_matches
from .stream import STAGES, put
from .trace import trace, trace_keypoints

__all__ = [
    "SCHEMA",
    "STAGES",
    "log_account",
    "log_cloud",
    "log_features",
    "log_fusion",
    "log_history",
    "log_images",
    "log_legend",
    "log_match",
    "log_matches",
    "log_pose",
    "log_reconstruction",
    "log_run",
    "log_timings",
    "log_two_view",
    "log_uncertainty",
    "save_recording",
]

SCHEMA = 1  # of the recording; docs/recording.md says what each number means


def save_recording(
    path: str | Path,
    result: Reconstruction,
    *,
    originals: bool = False,
) -> None:
    """Write a whole reconstruction, with the layout of its views, to one .rrd file.

    Args:
        path: appears whole or not at all; a file that is there is replaced.
        originals: keep the photographs as they are (the file's own JPEG, or PNG) instead of at JPEG
            quality 80.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary:
        rec = rr.RecordingStream("sfmkit", recording_id=Path(path).stem, send_properties=False)
        rec.set_log_time_enabled(False)
        rec.set_log_tick_enabled(False)
        try:
            rec.save(temporary, default_blueprint=default_blueprint(result))
            rec.send_recording_name(
                " + ".join(name_of(image, n) for n, image in enumerate(result.images, start=1))
            )
            log_reconstruction(rec, result, originals=originals)
            rec.flush()
        except (RuntimeError, ValueError) as error:
            raise OutputError(f"{path} cannot be written: {error}") from error
        finally:
            rec.disconnect()


def log_reconstruction(
    rec: rr.RecordingStream,
    result: Reconstruction,
    prefix: str = "",
    *,
    originals: bool = False,
) -> None:
    """Everything of a reconstruction, stage by stage."""
    view, corr, cloud = result.two_view, result.correspondences, result.cloud
    cameras = (view.camera1, view.camera2)
    kind = result.options.estimate.model
    traced = trace(corr, view, cloud, result.options.estimate.threshold_px)
    depth = float(cloud.xyz[:, 2].median()) if cloud is not None and len(cloud) else 4.0
    for stage, words in text.story(result).items():
        put(rec, prefix, "story", rr.TextDocument(words, media_type="text/markdown"), stage=stage)
    log_legend(rec, corr.operators, prefix)
    log_images(rec, result.images, cameras, prefix, originals=originals, frustum=0.15 * depth)
    became = trace_keypoints(result.features, result.matches, corr, traced)
    log_features(rec, result.features, cameras, prefix, became=became)
    log_matches(rec, result.features, result.matches, cameras, prefix)
    log_fusion(rec, result.features, result.matches, corr, cameras, prefix)
    log_history(rec, view.history, corr, cameras, prefix, kind=kind)
    log_two_view(rec, corr, view, traced, prefix)
    log_pose(rec, corr, view, prefix, frustum=0.15 * depth)
    if cloud is not None and len(cloud):
        log_cloud(rec, cloud, corr, view, prefix)
        log_uncertainty(rec, cloud, corr, prefix)
        log_match(rec, int(cloud.match[marks.telling_point(cloud)]), corr, view, cloud, prefix)
    log_account(rec, result.account, prefix)
    log_timings(rec, result.timings_s, prefix)
    put(
        rec,
        prefix,
        "summary",
        rr.TextDocument(text.report_markdown(result), media_type="text/markdown"),
    )
    put(
        rec,
        prefix,
        "verdict",
        rr.TextDocument(text.verdict_markdown(view), media_type="text/markdown"),
        stage="estimate",
    )
    report = {"schema": SCHEMA, **make_report(result)}
    put(
        rec,
        prefix,
        "report",
        rr.TextDocument(json.dumps(report, indent=1), media_type="text/plain"),
    )


def log_run(
    rec: rr.RecordingStream,
    result: Reconstruction,
    run: int,
    prefix: str = "",
    *,
    images: bool = True,
) -> None:
    """One of many reconstructions of the same pair, at `run` on the timeline ``run``: what an
    ablation compares.

    Args:
        images: log the photographs too; do so for the first run of a pair only, they are the same
            for all.
    """
    rec.set_time("run", sequence=run)
    view, corr, cloud = result.two_view, result.correspondences, result.cloud
    traced = trace(corr, view, cloud, result.options.estimate.threshold_px)
    if images:
        log_images(rec, result.images, (view.camera1, view.camera2), prefix)
    log_legend(rec, corr.operators, prefix)
    put(rec, prefix, "world", rr.Clear(recursive=True), stage="estimate")
    put(rec, prefix, "matches", rr.Clear(recursive=True), stage="estimate")
    log_two_view(rec, corr, view, traced, prefix)
    log_pose(rec, corr, view, prefix)
    if cloud is not None and len(cloud):
        log_cloud(rec, cloud, corr, view, prefix)
    words = f"# run {run}: {', '.join(corr.operators)}\n\n{text.report_markdown(result)}"
    put(rec, prefix, "summary", rr.TextDocument(words, media_type="text/markdown"), stage="refine")
    rec.disable_timeline("run")


def log_legend(rec: rr.RecordingStream, operators: Sequence[str], prefix: str = "") -> None:
    """Name and colour of every operator; class id k is ``operators[k]``."""
    infos = [rr.AnnotationInfo(k, name, operator_rgb(name)) for k, name in enumerate(operators)]
    put(rec, prefix, "", rr.AnnotationContext(infos))


def log_account(
    rec: rr.RecordingStream, account: Mapping[str, OperatorAccount], prefix: str = ""
) -> None:
    """The account as a table and as bars: for each operator keypoints of image 1, matches, fused,
    inliers, points."""
    document = rr.TextDocument(text.account_markdown(account), media_type="text/markdown")
    put(rec, prefix, "account/table", document)
    names = [name for name in account if name != ALL]
    for k, name in enumerate(names):
        a = account[name]
        bars = np.array([a.keypoints[0], a.matches, a.initial, a.inliers, a.points])
        places = np.arange(len(bars)) * (len(names) + 1) + k
        chart = rr.BarChart(
            bars, abscissa=places, widths=np.ones(len(bars)), color=operator_rgb(name)
        )
        put(rec, prefix, ["account/chart", name], chart)


def log_timings(rec: rr.RecordingStream, timings_s: Mapping[str, float], prefix: str = "") -> None:
    """Seconds per stage, a bar each."""
    for k, (stage, seconds) in enumerate(s for s in timings_s.items() if s[0] != "total"):
        colour = tuple(int(255 * c) for c in colormaps["cividis"](k / 7)[:3])
        put(
            rec,
            prefix,
            ["timings", stage],
            rr.BarChart(np.array([seconds]), abscissa=np.array([k]), color=colour),
        )
