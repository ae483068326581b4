"""The paper's Tables 7 and 8 from rows of the drone benchmark, and pictures of the clouds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from .._utils.writing import atomic_write
from ..io.images import read_image
from ..io.ply import read_ply
from ..reports.result import Cell, Column, Result, ResultFigure, ResultTable
from ..viz.splats import splat
from .paper import UAV
from .rows import Row
from .uav import ALL_OF, SMALL, WIDE, Box, Flight, ply_name

_TABLES = {SMALL: 7, WIDE: 8}
_PRESETS = {
    "default": "sfmkit, default preset",
    "dense": "sfmkit, dense preset",
    "paper": "sfmkit, the paper's recipe",
}
_PITCH_DEG = -25.0  # of the view in the pictures
_GREY = 45  # background of the clouds; roads and roofs are pale
_WIDTH = 800  # pixels of a photograph or cloud in the figures


def uav_result(rows: Sequence[Row], flight: Flight, box: Box, folder: Path, command: str) -> Result:
    """Make the tables of the rows, and draw the figures into `folder`."""
    cases = [case for case in _TABLES if case in flight.cases]
    pair = flight.cases[SMALL][0]
    camera = next(r["camera"] for r in rows if r["kind"] == "pair")
    return Result(
        name="uav",
        title=(
            f"Drone photographs {pair.sequence}: {len(flight.photographs)} of "
            f"{' x '.join(map(str, flight.camera.size_wh))} pixels"
        ),
        command=command,
        tables=(*(_case_table(rows, flight, case) for case in cases), _pairs_table(rows, cases)),
        figures=(
            _draw_target(flight, box, folder),
            *(_draw_clouds(rows, flight, case, folder) for case in cases),
        ),
        seeds=(0,),
        notes=(
            "The photographs of the paper show an antenna and are not public. Its numbers are of "
            "another scene and cannot be compared directly. The paper ran MicMac on 31 and 93 "
            "photographs.",
            f"Source of the camera: {camera}. COLMAP uses the same camera with fixed intrinsics. "
            "It keeps points seen in only two photographs, because all points of sfmkit are of "
            "this kind, and drops points with a parallax below 1.5 degrees.",
            f"Target: points inside the box {', '.join(f'{v:.0f}' for v in box)} of the first "
            "photograph. Seconds: one run from reading the photographs to the cloud, without "
            "loading the libraries, on the stated machine and load.",
        ),
    )


def _case_table(rows: Sequence[Row], flight: Flight, case: str) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    first = flight.cases[case][0]
    for r in rows:
        if r["kind"] == "pair" and r["case"] == case and r["pair"] == first.name:
            lines.append(
                (_PRESETS.get(r["preset"], r["preset"]), 2, r["seconds"], r["points"], r["target"])
            )
        elif r["kind"] == "colmap" and (r["case"] == case or r["given"] == ALL_OF):
            if "missing" in r:
                lines.append((f"COLMAP, not run: {r['missing']}", None, None, None, None))
                continue
            placed, given = r["images"]
            label = "COLMAP" if placed == given else f"COLMAP, {placed} registered"
            lines.append((label, given, sum(r["seconds"].values()), r["points"], r["target"]))
        elif r["kind"] == "given" and r["case"] == case:
            lines.append(
                (
                    r["file"] + (f": {r['note']}" if r.get("note") else ""),
                    None,
                    None,
                    r["points"],
                    r["target"],
                )
            )
    for who, (images, minutes, points, antenna) in UAV[case].items():
        lines.append(
            (
                f"the paper: {who}, antenna",
                images,
                None if minutes is None else 60 * minutes,
                points,
                antenna,
            )
        )
    columns = (
        Column("method"),
        Column("photographs", ","),
        Column("seconds", ",.1f"),
        Column("points", ","),
        Column("points of the target", ","),
    )
    number = _TABLES[case]
    return ResultTable(
        f"table-{number}", f"Table {number}: {case}, pair {first.name}", columns, tuple(lines)
    )


def _pairs_table(rows: Sequence[Row], cases: Sequence[str]) -> ResultTable:
    lines = [
        (
            r["case"],
            r["pair"],
            r["preset"],
            r["verdict"],
            r["initial"],
            r["points"],
            100 * (1 - r["points"] / r["initial"]) if r["initial"] else None,
            r["reprojection_rmse_px"],
            *(r["sigma_deg"] or (None, None)),
            r["seconds"],
        )
        for case in cases
        for r in rows
        if r["kind"] == "pair" and r["case"] == case
    ]
    columns = (
        Column("case"),
        Column("pair"),
        Column("preset"),
        Column("verdict"),
        Column("initial", ","),
        Column("points", ","),
        Column("loss, %", ".1f"),
        Column("reprojection, px", ".2f"),
        Column("± rotation, deg", ".4f"),
        Column("± translation, deg", ".4f"),
        Column("seconds", ".1f"),
    )
    note = (
        "±: standard deviations of the pose as computed by the run; there is no ground truth. "
        "Reprojection: root mean square error of the points in both photographs."
    )
    return ResultTable("pairs", "Every pair", columns, tuple(lines), note)


def _draw_target(flight: Flight, box: Box, folder: Path) -> ResultFigure:
    """Draw the first photograph with the box."""
    image = read_image(flight.photographs[0])
    w, h = image.size_wh
    step = max(1, w // _WIDTH)
    figure = Figure(figsize=(8, 8 * h / w), layout="constrained")
    ax = figure.add_subplot()
    ax.imshow(image.rgb[::step, ::step], extent=(-0.5, w - 0.5, h - 0.5, -0.5))
    x0, y0, x1, y1 = box
    ax.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="white", linewidth=4))
    ax.add_patch(
        Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="#D55E00", linewidth=2)
    )
    ax.set(xlabel="x (pixels)", ylabel="y (pixels)")
    _save(figure, folder / "target.png")
    return ResultFigure(
        "The target in the first photograph",
        "target.png",
        "The first photograph with a box around the target",
    )


def _draw_clouds(rows: Sequence[Row], flight: Flight, case: str, folder: Path) -> ResultFigure:
    """Draw the clouds of the first pair of a case side by side."""
    there = {label: folder / ply_name(case, p) for p, label in _PRESETS.items()}
    there["COLMAP, 2 photographs"] = folder / ply_name(case, "colmap-2")
    there[f"COLMAP, {len(flight.photographs)} photographs"] = folder / ply_name(
        SMALL, f"colmap-{ALL_OF}"
    )
    for r in rows:
        if r["kind"] == "given" and r["case"] == case:
            there[r["file"]] = folder / ply_name(case, f"given-{Path(r['file']).stem}")
    clouds = {label: read_ply(path) for label, path in there.items() if path.is_file()}
    lines = max(1, (len(clouds) + 1) // 2)
    w, h = flight.camera.size_wh
    figure = Figure(figsize=(12, lines * (6 * h / w + 0.3)), layout="constrained")
    axes = np.ravel(figure.subplots(lines, 2, squeeze=False))
    for ax in axes:
        ax.set_axis_off()
    for ax, (label, cloud) in zip(axes, clouds.items()):
        ax.imshow(
            splat(
                cloud, flight.camera, width=_WIDTH, dot=2, pitch_deg=_PITCH_DEG, background=_GREY
            ),
            interpolation="none",
        )
        ax.set_title(f"{label}: {len(cloud):,} points", fontsize=11)
    file = f"clouds-{case.replace(' ', '-')}.png"
    _save(figure, folder / file)
    return ResultFigure(
        f"Clouds of the {case}, oblique view",
        file,
        f"Point clouds of the {case}: {', '.join(clouds)}",
    )


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")
