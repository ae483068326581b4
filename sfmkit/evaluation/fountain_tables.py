"""The paper's Table 6 and Figure 11, and accuracy tables, from rows of the fountain benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..pipeline.account import ALL
from ..reports.result import Cell, Column, Result, ResultFigure, ResultTable
from .fountain import RIGHT_PX, cloud_picture
from .paper import FOUNTAIN
from .rows import Row

PRESET_TITLES = {
    "paper": "the paper's recipe",
    "default": "default preset",
    "dense": "dense preset",
}


def fountain_result(rows: Sequence[Row], folder: Path, command: str) -> Result:
    """Make the tables of the rows, and list the figures that exist in `folder`."""
    clouds = [r for r in rows if r["kind"] == "cloud"]
    first = clouds[0]["pair"]
    presets = list(dict.fromkeys(r["preset"] for r in clouds))
    tables = [
        _table_6([r for r in clouds if r["pair"] == first and r["preset"] == p], p) for p in presets
    ]
    tables.append(_truth_table([r for r in clouds if r["pair"] == first]))
    if len({r["pair"] for r in clouds}) > 1:
        tables.append(_pairs_table(clouds))
    if any(r["kind"] == "scene" for r in rows):
        tables.append(_scenes_table([r for r in rows if r["kind"] == "scene"]))
    figures = tuple(
        ResultFigure(
            f"Figure 11: the clouds of pair {first}, {PRESET_TITLES[preset]}",
            cloud_picture(preset),
            f"Point clouds of the single operators and of all together, {PRESET_TITLES[preset]}, "
            "seen from camera 1",
        )
        for preset in presets
        if (folder / cloud_picture(preset)).is_file()
    )
    return Result(
        name="fountain",
        title=(
            f"EPFL fountain-P11: from features to the cloud, {len({r['pair'] for r in clouds})} "
            "pairs"
        ),
        command=command,
        tables=tuple(tables),
        figures=figures,
        seeds=tuple(sorted({r["seed"] for r in clouds})),
        notes=(
            "Initial is the number of matches from which the geometry is estimated; loss is the "
            "share of them that was not triangulated. In one place the paper defines initial as "
            "the detected features, in another the loss as that from matching to the final cloud. "
            "Its numbers agree only with the second definition.",
            "The paper adds the matches of the operators, so a corner found by two operators "
            "counts twice. The presets default and dense merge such matches; the line “multi, "
            "unmerged” counts them as in the paper.",
            "The preset dense differs from default in three settings: half the contrast "
            "thresholds, twice as many keypoints, and a ratio test at 0.9. Initial counts the "
            "matches that passed the ratio test, as does the column of matches.",
        ),
    )


def _median(rows: Sequence[Row], key: str) -> float | None:
    values = [r[key] for r in rows if r[key] is not None]
    return float(np.median(values)) if values else None


def _percent(value: float | None) -> float | None:
    return None if value is None else 100 * value


def _lines(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Group rows by operator, all together, and all without merging: (label, rows)."""
    lines: dict[tuple[str, bool], list[Row]] = {}
    for r in rows:
        lines.setdefault((r["operator"], r["merged"]), []).append(r)
    merges = {merged for name, merged in lines if name == ALL}
    return [
        (f"{name}, unmerged" if name == ALL and not merged and len(merges) > 1 else name, group)
        for (name, merged), group in lines.items()
    ]


def _table_6(rows: Sequence[Row], preset: str) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    together = next((group for name, group in _lines(rows) if name == ALL), None)
    for name, group in _lines(rows):
        r = group[0]
        points, loss = _median(group, "points"), _median(group, "loss")
        initial, paper_points, paper_loss = FOUNTAIN.get(r["operator"], (None, None, None))
        inside = (
            None
            if together is None or name not in together[0]["members"]
            else together[0]["members"][name][1]
        )
        share, whole = (
            (None, None)
            if together is None
            else (r["initial"] / together[0]["initial"], _median(together, "points"))
        )
        lines.append(
            (
                name,
                sum(r["keypoints"]) // 2,
                r["matches"],
                r["initial"],
                initial,
                _percent(share),
                points,
                paper_points,
                _percent(None if not whole or points is None else points / whole),
                inside,
                _percent(loss),
                paper_loss,
            )
        )
    columns = (
        Column("operator"),
        Column("keypoints an image", ","),
        Column("matches", ","),
        Column("initial", ","),
        Column("paper: initial", ",", paper=True),
        Column("initial of all, %", ".1f"),
        Column("points", ",.0f"),
        Column("paper: points", ",", paper=True),
        Column("points of all, %", ".1f"),
        Column("points within the fusion", ","),
        Column("loss, %", ".2f"),
        Column("paper: loss, %", ".2f", paper=True),
    )
    note = (
        "Single operators are estimated alone. The paper apparently did the same, because its "
        "points add up to 26,725 and not to 27,673. Points within the fusion: points of the fused "
        "cloud that the operator found, alone or with others."
    )
    return ResultTable(
        f"table-6-{preset}",
        f"Table 6: features through the process, {PRESET_TITLES[preset]}",
        columns,
        tuple(lines),
        note,
    )


def _truth_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for preset in dict.fromkeys(r["preset"] for r in rows):
        for name, group in _lines([r for r in rows if r["preset"] == preset]):
            worst = [
                max((r[k] for r in group if r[k] is not None), default=None)
                for k in ("rotation_deg", "translation_deg")
            ]
            lines.append(
                (
                    preset,
                    name,
                    _median(group, "points"),
                    _percent(_median(group, "precision")),
                    _percent(_median(group, "kept")),
                    _median(group, "rotation_deg"),
                    worst[0],
                    _median(group, "translation_deg"),
                    worst[1],
                    _median(group, "seconds"),
                )
            )
    columns = (
        Column("preset"),
        Column("operator"),
        Column("points", ",.0f"),
        Column("right, %", ".2f"),
        Column("right ones kept, %", ".1f"),
        Column("rotation, deg", ".3f"),
        Column("rotation, worst", ".3f"),
        Column("translation, deg", ".3f"),
        Column("translation, worst", ".3f"),
        Column("seconds", ".1f"),
    )
    note = (
        f"Right: share of the cloud's matches with a Sampson distance below {RIGHT_PX:g} px to "
        "the true epipolar geometry. Right ones kept: share of all right matches that were "
        "triangulated. Errors of the rotation and of the direction of the translation: median and "
        "worst over the seeds; below about 0.03 and 0.1 degrees they measure the error of the "
        "ground truth. Seconds: from reading to triangulation, on the stated machine and load."
    )
    return ResultTable(
        "truth", f"Against the true cameras, pair {rows[0]['pair']}", columns, tuple(lines), note
    )


def _pairs_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    fusion = [r for r in rows if r["operator"] == ALL] or list(rows)
    for pair in dict.fromkeys(r["pair"] for r in fusion):
        for preset in dict.fromkeys(r["preset"] for r in fusion):
            for name, group in _lines(
                [r for r in fusion if r["pair"] == pair and r["preset"] == preset]
            ):
                lines.append(
                    (
                        pair,
                        preset,
                        "" if name == ALL else name.removeprefix(f"{ALL}, "),
                        group[0]["initial"],
                        _median(group, "points"),
                        _percent(_median(group, "loss")),
                        _percent(_median(group, "precision")),
                        _median(group, "rotation_deg"),
                        _median(group, "translation_deg"),
                    )
                )
    columns = (
        Column("pair"),
        Column("preset"),
        Column(""),
        Column("initial", ","),
        Column("points", ",.0f"),
        Column("loss, %", ".2f"),
        Column("right, %", ".2f"),
        Column("rotation, deg", ".3f"),
        Column("translation, deg", ".3f"),
    )
    return ResultTable(
        "pairs", "All operators together, all pairs of neighbours", columns, tuple(lines)
    )


def _scenes_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for scene in dict.fromkeys(r["scene"] for r in rows):
        for preset in dict.fromkeys(r["preset"] for r in rows):
            group = [r for r in rows if r["scene"] == scene and r["preset"] == preset]
            lines.append(
                (
                    scene,
                    preset,
                    group[0]["initial"],
                    _median(group, "points"),
                    _percent(_median(group, "median_error")),
                    _percent(_median(group, "p90_error")),
                    _percent(_median(group, "close")),
                    _median(group, "rotation_deg"),
                    _median(group, "translation_deg"),
                )
            )
    columns = (
        Column("scene"),
        Column("preset"),
        Column("initial", ","),
        Column("points", ",.0f"),
        Column("distance, % of depth", ".2f"),
        Column("9 of 10 below", ".2f"),
        Column("within 1 %, %", ".1f"),
        Column("rotation, deg", ".3f"),
        Column("translation, deg", ".3f"),
    )
    note = (
        "Median distance between the points and the surface at their pixel of image 1, in per "
        "cent of the depth. The cloud is scaled by the true length of the baseline and not "
        "aligned otherwise. All operators together."
    )
    return ResultTable(
        "scenes",
        "Rendered scenes: distance of the cloud to the surfaces",
        columns,
        tuple(lines),
        note,
    )
