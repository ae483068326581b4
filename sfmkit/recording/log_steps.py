"""Log what happens step by step: hypotheses of RANSAC, refinement steps, runs of an ablation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from ..errors import InputError
from ..types import Camera
from . import marks
from .log_geometry import log_epipolar_lines
from .stream import GREEN, GREY, STAGES, Size, columns, pinhole, points_2d, put


def log_ransac(
    rec: rr.RecordingStream,
    models: Sequence[Any],
    inliers: Sequence[int],
    x1: Any,
    x2: Any,
    *,
    sizes_wh: tuple[Size, Size],
    scores: Sequence[float] | None = None,
    steps: Sequence[str] | None = None,
    samples: Sequence[int] | None = None,
    sample: int = 12,
    prefix: str = "",
) -> None:
    """Log the hypotheses of a robust estimate on the timeline ``iteration``.

    Each hypothesis has its number of inliers, its score and the epipolar lines of the same sample
    of matches, so that the lines move into place as the estimate improves.

    Args:
        models: S fundamental matrices (3, 3), ``x2^T F x1 = 0``, pixels.
        inliers: (S,) size of each consensus set.
        x1, x2: (N, 2) matches in pixels without distortion.
        sizes_wh: sizes of the two images, pixels.
        scores: (S,) mean score per match.
        steps: (S,) what made the hypothesis, e.g. ``sample`` or ``local optimisation``.
        samples: (S,) minimal samples drawn by then.
        sample: number of matches whose lines are drawn.

    Raises:
        InputError: lists of different lengths.
    """
    models, inliers = list(models), list(inliers)
    for name, values in (("inliers", inliers), ("scores", scores), ("steps", steps)):
        if values is not None and len(values) != len(models):
            raise InputError(f"{len(models)} models need {len(models)} {name}, not {len(values)}")
    if not models:
        return
    x1, x2 = points_2d("x1", x1), points_2d("x2", x2)
    rows = marks.spread(x1, sample)
    for quantity, name in (("inliers", "inliers"), ("score", "mean score per match")):
        look = rr.SeriesLines(names=name, interpolation_mode="StepAfter")
        put(rec, prefix, f"estimation/{quantity}", look)
    for number, (F, count) in enumerate(zip(models, inliers)):
        rec.set_time("iteration", sequence=number)
        own = {} if steps is None else {"step": [steps[number]]}
        own |= {} if samples is None else {"samples": [samples[number]]}
        at = "estimation/inliers"
        put(rec, prefix, at, rr.Scalars(count), columns(**own), stage="estimate")
        if scores is not None:
            put(rec, prefix, "estimation/score", rr.Scalars(scores[number]), stage="estimate")
        log_epipolar_lines(rec, F, x1, x2, sizes_wh=sizes_wh, rows=rows, prefix=prefix)
    rec.disable_timeline("iteration")
    chart = rr.BarChart(np.array(inliers), color=GREY)
    put(rec, prefix, "estimation/improvements", chart)


def log_refinement(
    rec: rr.RecordingStream,
    cost: Any,
    poses: Sequence[tuple[Any, Any]] = (),
    *,
    camera: Camera | None = None,
    frustum: float = 0.5,
    prefix: str = "",
) -> None:
    """Log the steps of a refinement on the timeline ``step``: cost, and camera 2 as it moves.

    Args:
        cost: (S,) the cost at the start and after each step.
        poses: (R, t) at the start and after each step; needs `camera`.
        camera: intrinsics of camera 2.
        frustum: size of the drawn camera, baselines.

    Raises:
        InputError: poses without a camera.
    """
    if len(poses) and camera is None:
        raise InputError("poses need `camera`, the intrinsics of camera 2")
    look = rr.SeriesLines(names="cost", interpolation_mode="StepAfter")
    put(rec, prefix, "refinement/cost", look)
    for step, value in enumerate(np.asarray(cost, dtype=np.float64).tolist()):
        rec.set_time("step", sequence=step)
        put(rec, prefix, "refinement/cost", rr.Scalars(value), stage="refine")
    for step, (R, t) in enumerate(poses):
        assert camera is not None
        rec.set_time("step", sequence=step)
        place = rr.Transform3D(
            mat3x3=np.asarray(R),
            translation=np.asarray(t),
            relation=rr.TransformRelation.ChildFromParent,
        )
        put(rec, prefix, "world/refinement", place, stage="refine")
        put(
            rec,
            prefix,
            "world/refinement/frustum",
            pinhole(camera, frustum, color=GREEN),
            stage="refine",
        )
    rec.disable_timeline("step")


def log_runs(
    rec: rr.RecordingStream, runs: Iterable[Mapping[str, Any]], *, prefix: str = ""
) -> None:
    """Log the rows of an ablation's table on the timeline ``run``.

    Finite numbers become series under ``runs/QUANTITY``; everything else is listed in ``runs/row``.

    Args:
        runs: one mapping per run, e.g. the rows of :func:`sfmkit.ablation.ablate`'s table.
    """
    for number, row in enumerate(runs):
        rec.set_time("run", sequence=number)
        lines = [f"## run {number}", "", "| quantity | value |", "|:--|--:|"]
        for name, value in row.items():
            if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
                lines.append(f"| {name} | {value:.4g} |")
                if np.isfinite(value):
                    put(rec, prefix, ["runs", name], rr.Scalars(float(value)), stage=STAGES[-1])
            else:
                lines.append(f"| {name} | {value} |")
        words = rr.TextDocument("\n".join(lines), media_type="text/markdown")
        put(rec, prefix, "runs/row", words, stage=STAGES[-1])
    rec.disable_timeline("run")
