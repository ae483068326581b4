"""The worst cases of an ablation, repeated for inspection."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..._utils.progress import Progress
from ...errors import InputError, SfmError
from ...io.images import Image, read_image
from ...pipeline.reconstruction import Reconstruction, reconstruct
from ...pipeline.registration import Registration, register
from ...types import Camera, FrozenMapping
from .. import read_sweep, read_table
from ..variants import JOIN, Variant
from .findings import Findings
from .scores import MEASURES, Row

_BETTER = 0.9  # a run with a larger share of the error is not shown for comparison


@dataclass(frozen=True, eq=False)
class Case:
    """A run with a large error.

    Attributes:
        row: the run.
        better: the best run on the same pair; None if none is much better.
        pair: images, cameras and truth, as stored in the folder of the sweep.
    """

    row: Row
    better: Row | None
    pair: Mapping[str, Any]

    @property
    def runs(self) -> tuple[Row, ...]:
        return (self.row,) if self.better is None else (self.row, self.better)


@dataclass(frozen=True, eq=False)
class Rerun:
    """A repeated run.

    Attributes:
        row: the row of the sweep.
        images: of the pair.
        result: the new result; None if it failed.
        failure: the reason of the failure.
        same: whether the estimate equals that of the sweep, to a relative difference of 1e-6.
    """

    row: Row
    images: tuple[Image, Image]
    result: Reconstruction | Registration | None
    failure: str
    same: bool


def choose_worst(
    folders: Sequence[Path], findings: Sequence[Findings], most: int, combination: str | None = None
) -> list[Case]:
    """Choose the pairs with the largest errors relative to the threshold of their data set.

    The error of a pair is that of its worst seed.

    Args:
        folders: of the sweeps.
        findings: of their data sets.
        most: at most this many.
        combination: whose runs, ``surf/orb`` in any order; None: of each data set's best setup.

    Raises:
        InputError: the sweep has no such combination, or there are no runs with images and a truth.
    """
    asked = (
        None if combination is None else frozenset(part.strip() for part in combination.split(JOIN))
    )
    if asked is not None and not any(
        asked == frozenset(s.operators) for f in findings for s in f.scores.setups
    ):
        known = ", ".join(dict.fromkeys(s.combination for f in findings for s in f.scores.setups))
        raise InputError(
            f"no run of this sweep has the combination '{combination}'; it has {known}"
        )
    best = {
        (f.scores.dataset.split(" (")[0], f.scores.measure.unit): f.scores.setups[f.best]
        for f in findings
    }

    def wanted(row: Row) -> bool:
        if asked is not None:
            return asked == frozenset(row["operators"])
        s = best[row["dataset"], MEASURES[row["error_unit"]].unit]
        return (tuple(row["operators"]), row["preset"], row["vary"]) == (
            s.operators,
            s.preset,
            s.vary,
        )

    pairs = {
        (p["dataset"], p["sequence"], p["pair"]): p
        for folder in folders
        for p in read_sweep(folder)["pairs"]
    }
    threshold = {f.scores.measure.unit: f.scores.measure.main for f in findings}
    worst: dict[tuple, Row] = {}
    least: dict[tuple, Row] = {}
    for row in (row for folder in folders for row in read_table(folder)):
        if not row["has_truth"] or row["status"] == "failed":
            continue
        key = (row["dataset"], row["sequence"], row["pair"])
        if wanted(row) and (key not in worst or row["error"] > worst[key]["error"]):
            worst[key] = row
        if key not in least or row["error"] < least[key]["error"]:
            least[key] = row
    if not worst:
        raise InputError("there is no run to show: none has both its images and a true geometry")

    def excess(key: tuple) -> float:
        row = worst[key]
        return row["error"] / threshold[MEASURES[row["error_unit"]].unit]

    ordered = sorted(worst, key=excess, reverse=True)
    return [
        Case(
            worst[key],
            least[key] if least[key]["error"] < _BETTER * worst[key]["error"] else None,
            pairs[key],
        )
        for key in ordered[:most]
    ]


def run_again(case: Case, row: Row, progress: Progress | None = None) -> Rerun:
    """Repeat one of the runs of a case, with its settings and seed.

    Raises:
        ImageError: An image is missing.
    """
    images = (
        read_image(case.pair["images"][0]["path"]),
        read_image(case.pair["images"][1]["path"]),
    )
    variant = Variant(row["preset"], tuple(json.loads(row["vary"]).items()))
    operators = sorted(row["operators"])  # the order in which a sweep fuses them
    overrides = {o: FrozenMapping(dict(variant.setting(o).options)) for o in operators}
    options = replace(
        variant.options,
        detect=replace(variant.options.detect, overrides=FrozenMapping(overrides)),
    )
    result: Reconstruction | Registration
    try:
        if case.pair["kind"] == "homography":
            options = replace(options, planar=variant.planar)
            result = register(
                *images, operators, options=options, seed=row["seed"], progress=progress
            )
            same = _same(((result.H, row["H"]),))
        else:
            cameras = [
                Camera(
                    np.array(c["K"]),
                    image.size_wh,
                    np.array(c["distortion"]),
                    c["source"],
                    c["model"],
                )
                for c, image in zip(case.pair["cameras"], images)
            ]
            truth = tuple(np.array(case.pair[name]) for name in ("R", "t"))
            known = truth if np.any(truth[1]) else None
            result = reconstruct(
                *images,
                cameras[0],
                operators,
                camera2=cameras[1],
                options=options,
                seed=row["seed"],
                truth=known,  # type: ignore[arg-type]
                progress=progress,
            )
            view = result.two_view if result.trustworthy else None
            same = _same(((view and view.R, row["R"]), (view and view.t, row["t"])))
    except SfmError as error:
        return Rerun(row, images, None, str(error), False)
    return Rerun(row, images, result, "", same)


def _same(pairs: Iterable[tuple[Any, Any]]) -> bool:
    for found, stored in pairs:
        if (found is None) != (stored is None):
            return False
        if found is not None:
            a, b = np.asarray(found).ravel(), np.asarray(stored)
            if not np.allclose(a, b, rtol=0, atol=1e-6 * max(1.0, float(np.abs(b).max()))):
                return False
    return True


def describe(case: Case, run: Rerun) -> str:
    """Describe a run and its result as Markdown."""
    row = run.row
    measure = MEASURES[row["error_unit"]]

    def error(r: Row) -> str:
        return (
            "no answer" if math.isinf(r["error"]) else f"{measure.show(round(r['error'], 3))} off"
        )

    lines = [
        f"# {row['dataset']} {row['sequence']} {row['pair']}: {error(row)}",
        f"**{row['combination']}**, preset {row['preset']}, seed {row['seed']}"
        + (f", {row['vary']}" if row["vary"] != "{}" else ""),
        f"{row['verdict']}: {row['reason']}" if row["verdict"] else "",
        "| keypoints 1 | 2 | matches | fused | inliers |\n|--:|--:|--:|--:|--:|\n| "
        + " | ".join(
            f"{row[k]:,}"
            for k in ("keypoints1", "keypoints2", "matches", "correspondences", "inliers")
        )
        + " |"
        if row["matches"] is not None
        else "",
    ]
    if row is case.row and case.better is not None:
        lines.append(
            f"Best on this pair: {case.better['combination']}, seed {case.better['seed']}, "
            f"{error(case.better)}."
        )
    if run.failure:
        lines.append(f"The rerun failed: {run.failure}")
    elif not run.same:
        lines.append(
            "The estimate of the rerun differs from that of the sweep: another machine or other "
            "code."
        )
    return "\n\n".join(line for line in lines if line)
