"""HTML page of a model: ``report.html``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..pipeline.account import ALL
from ..reports import page

__all__ = ["PAGE", "write_map_page"]

PAGE = "report.html"
_TRACKS = (
    "operator",
    "points",
    "found by it alone",
    "share",
    "track length",
    "error, px",
    "error of those alone, px",
)
_PHOTOGRAPHS = ("photograph", "registered", "keypoints", "observations", "focal length, px")
_FILES = (
    ("sparse/0, sparse-text/0", "the model in COLMAP's binary and text formats"),
    ("database.db", "keypoints, matches and geometries for COLMAP, with their provenance"),
    ("cloud.ply", "the points, with a bit for each operator that found them"),
    ("transforms.json", "the cameras for nerfstudio and Gaussian splatting"),
    ("recording.rrd", "the model for the Rerun viewer: sfmkit view recording.rrd"),
    ("pairs.parquet, pairs.csv", "one row per pair"),
    ("report.json", "the numbers of this page"),
)


def write_map_page(report: dict[str, Any], folder: Path, command: str = "") -> None:
    """Write the page of a model beside its pictures.

    Args:
        report: The content of ``report.json``.
        folder: Folder of ``model.png`` and ``graph.png``, to which the page is written.
        command: Command that made the model.
    """
    model = report["model"]
    sections = [("Model", _model(report, folder))]
    if model is not None:
        sections += [("Operators", _operators(report)), ("Photographs", _photographs(report))]
    sections += [("Pairs", _pairs(report, folder)), ("Files", page.facts(_FILES))]
    intro = [_summary(report)]
    text = page.page("Model of a folder of photographs", intro, sections)
    if command:
        text = text.replace("</h1>", f"</h1>{page.code(command)}", 1)
    (folder / PAGE).write_text(text, encoding="utf-8")


def _summary(report: dict[str, Any]) -> str:
    model, pairs = report["model"], report["pairs"]
    if model is None:
        return (
            f"COLMAP's {report['mapper']['mapper']} mapper found no model of the "
            f"{pairs['photographs']:,} photographs. The pairs below show what they have in common."
        )
    return (
        f"{model['registered']:,} of {model['photographs']:,} photographs were registered, with "
        f"{model['points']:,} points in {model['track_length']:.1f} photographs each on average; "
        f"their mean reprojection error is {model['reprojection_error_px']:.2f} px."
    )


def _model(report: dict[str, Any], folder: Path) -> str:
    html = ""
    if report["model"] is not None:
        html = page.figure(
            "Points and cameras in the frame of one of the cameras",
            folder / "model.png",
            "The points and cameras from above and from the front",
        )
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in report["seconds"].items())
    two_view = report["mapper"]["two_view_points"]
    facts = [
        ("mapper", f"COLMAP, {report['mapper']['mapper']}"),
        ("points seen by two photographs only", "kept" if two_view else "left out"),
        ("seconds", seconds),
        ("memory of the mapping process", f"{report['peak_memory_mb']:,} MB at most"),
    ]
    return html + page.facts(facts)


def _operators(report: dict[str, Any]) -> str:
    def cell(value: float | None, spec: str) -> str:
        return "" if value is None else format(value, spec)

    rows = [
        (
            "all" if name == ALL else name,
            f"{line['points']:,}",
            "" if name == ALL else f"{line['alone']:,}",
            f"{line['share']:.1%}",
            cell(line["track_length"], ".2f"),
            cell(line["error_px"], ".3f"),
            "" if name == ALL else cell(line["error_alone_px"], ".3f"),
        )
        for name, line in report["operators"].items()
    ]
    note = (
        "An operator found a point if it has a keypoint in at least two photographs of the track; "
        "a point that several operators found counts for each of them."
    )
    right = (False, *(True,) * 6)
    return page.table("Tracks per operator", _TRACKS, rows, right=right, note=note)


def _photographs(report: dict[str, Any]) -> str:
    rows = [
        (
            line["name"],
            "yes" if line["registered"] else "no",
            f"{line['keypoints']:,}",
            f"{line['observations']:,}",
            f"{line['K'][0][0]:.1f}" if line["K"] else "",
        )
        for line in report["photographs"]
    ]
    right = (False, False, True, True, True)
    return page.table("Photographs", _PHOTOGRAPHS, rows, right=right)


def _pairs(report: dict[str, Any], folder: Path) -> str:
    pairs = report["pairs"]
    facts = [
        ("pairs", f"{pairs['pairs']:,}, chosen by {pairs['rules']}"),
        *((verdict, f"{n:,}") for verdict, n in pairs["verdicts"].items()),
        ("skipped files", f"{len(pairs['skipped']):,}"),
    ]
    graph = page.figure("The pairs", folder / "graph.png", "The pairs as a graph and as a matrix")
    return page.facts(facts) + graph + page.paragraphs(pairs["warnings"], "note")
