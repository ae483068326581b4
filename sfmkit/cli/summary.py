"""Tables that the commands print: statistics per operator, pose, operators, results."""

from __future__ import annotations

from math import acos, degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..pipeline.account import ALL

if TYPE_CHECKING:
    from ..features import OperatorInfo
    from ..matching import MatcherInfo
    from ..reports.result import Result

_PRINTED_FILES = (
    ("report.json", "numbers"),
    ("cloud.ply", "the cloud, for any point cloud viewer"),
    ("recording.rrd", "every stage: sfmkit view recording.rrd"),
    ("matches.npz", "correspondences with their provenance"),
    ("matches.png", "picture of the matches"),
    ("cloud.png", "picture of the cloud"),
    ("colmap", "COLMAP text model"),
)


def account_table(operators: dict[str, Any]) -> Table:
    """Make a table of the per-operator statistics of a report."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("operator", no_wrap=True)
    for column in (
        "keypoints 1",
        "2",
        "matches",
        "fused",
        "share",
        "inliers",
        "points",
        "share",
        "loss",
    ):
        table.add_column(column, justify="right", no_wrap=True)
    for name, line in operators.items():
        if name == ALL:
            table.add_section()
        table.add_row(
            "all" if name == ALL else name,
            *(f"{v:,}" for v in (*line["keypoints"], line["matches"], line["initial"])),
            f"{line['share_initial']:.1%}",
            f"{line['inliers']:,}",
            f"{line['points']:,}",
            f"{line['share_points']:.1%}",
            f"{line['loss']:.1%}",
        )
    return table


def print_summary(report: dict[str, Any], folder: Path) -> None:
    """Print statistics, verdict, pose, times and files."""
    console = wide_console()
    console.print(account_table(report["operators"]))
    verdict, pose = report["verdict"], report["pose"]
    facts = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    facts.add_row("verdict", f"{verdict['kind']}: {verdict['reason']}")
    if pose is not None:
        line = f"rotation {_angle(pose['R']):.3f} deg"
        if pose["t"] is not None:
            line += ", translation direction (" + ", ".join(f"{v:+.4f}" for v in pose["t"]) + ")"
        facts.add_row("pose", line)
        if pose["sigma_deg"] is not None:
            facts.add_row(
                "",
                "standard deviation {:.4f} deg rotation, {:.4f} deg translation".format(
                    *pose["sigma_deg"]
                ),
            )
            for part, deg in pose["sigma_parts_deg"].items():
                facts.add_row("", f"  {part}: {deg[0]:.4f}, {deg[1]:.4f} deg")
        for other in pose["alternatives"]:
            direction = ", ".join(f"{v:+.4f}" for v in other["t"])
            facts.add_row("or", f"rotation {_angle(other['R']):.3f} deg, translation ({direction})")
    held_out = {n: line["log10_chance"] for n, line in report["operators"].items()}
    if any(tail is not None for tail in held_out.values()):
        tails = [f"{n} 10^{tail:,.0f}" for n, tail in held_out.items() if tail is not None]
        facts.add_row(
            "operators", f"agree by chance with the pose of the others: {', '.join(tails)}"
        )
    if "errors" in report:
        errors = report["errors"]
        shown = [
            "-" if v is None else f"{v:.4f} deg"
            for v in (errors["rotation_deg"], errors["translation_deg"])
        ]
        facts.add_row(
            "error",
            f"rotation {shown[0]}, translation direction {shown[1]}, with respect to --truth",
        )
    if report["reprojection_rmse_px"] is not None:
        facts.add_row(
            "residual",
            f"{report['reprojection_rmse_px']:.3f} px root mean square reprojection error",
        )
    facts.add_row("camera", " | ".join(dict.fromkeys(map(_camera, report["camera"]))))
    facts.add_row("time", ", ".join(f"{k} {v:.2f} s" for k, v in report["timings_s"].items()))
    for warning in report["warnings"]:
        facts.add_row("warning", warning)
    console.print(facts)
    files = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    for name, what in _PRINTED_FILES:
        if (folder / name).exists():
            files.add_row(str(folder / name), what)
    console.print()
    console.print(files)


def _camera(camera: dict[str, Any]) -> str:
    """Where the focal length of a camera came from, and how certain it is."""
    focal, sigma = camera["K"][0][0], camera["sigma"]["focal"]
    return f"{camera['source']}: focal length {focal:.0f} px, standard deviation {sigma:.1%}"


def _angle(R: list[list[float]]) -> float:
    """Compute the angle of a rotation matrix, degrees."""
    trace = sum(R[i][i] for i in range(3))
    return degrees(acos(max(-1.0, min(1.0, (trace - 1) / 2))))


def print_matchers(rows: list[MatcherInfo]) -> None:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("matcher", "for operators", "available", "licence", "what it is"):
        table.add_column(column, overflow="fold")
    for row in rows:
        available = "yes" if row.available else row.reason
        table.add_row(row.name, row.operators, available, row.licence, row.summary)
    wide_console().print(table)


def print_operators(rows: list[OperatorInfo]) -> None:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("operator", "norm", "width", "available", "licence and patents", "what it is"):
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(
            row.name,
            row.norm,
            row.width,
            "yes" if row.available else row.reason,
            row.licence,
            row.summary,
        )
    wide_console().print(table)


def print_result(result: Result) -> None:
    """Print the tables and notes of a benchmark."""
    console = wide_console()
    for shown in result.tables:
        table = Table(title=shown.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        for column in shown.columns:
            table.add_column(
                column.name, justify="right" if column.right else "left", overflow="fold"
            )
        for row in shown.shown():
            table.add_row(*(escape(cell) for cell in row))
        console.print(table)
        if shown.note:
            console.print(escape(shown.note), end="\n\n")
    for note in result.notes:
        console.print(escape(note), end="\n\n")


def wide_console() -> Console:
    """Make a console; without a terminal it is wide enough for all tables."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=140)
