"""``sfmkit page``: a recording as one self-contained HTML page that answers clicks."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .._utils.writing import atomic_write, check_file
from ..errors import InputError
from ..recording import read_recording
from ..recording.inspection import Tables, read_tables, rejections
from ..recording.inspection.lives import WORDS, matching_rule, reasons
from ..recording.inspection.questions import HEAD, rejection_rows
from ..viz.colours import operator_colour
from . import page

__all__ = ["write_inspector"]

FILE = "inspect.html"
_SIDE = 1600  # largest side of a photograph on the page, pixels
_QUALITY = 80  # of its JPEG compression


def find_recording(path: str | os.PathLike) -> Path:
    """Return the recording of a folder of outputs, or the path itself.

    Raises:
        InputError: a folder without ``recording.rrd``.
    """
    path = Path(path)
    if not path.is_dir():
        return path
    if not (path / "recording.rrd").is_file():
        raise InputError(f"{path} has no recording.rrd; `sfmkit reconstruct` writes one")
    return path / "recording.rrd"


def write_inspector(
    recording: str | os.PathLike, out: str | os.PathLike | None = None, prefix: str = ""
) -> Path:
    """Write the page of a recording.

    Args:
        recording: an .rrd file, or a folder that contains ``recording.rrd``.
        out: the file; None for ``inspect.html`` beside the recording.
        prefix: entity path of the reconstruction.

    Raises:
        InputError: no recording, a damaged one, or one without a reconstruction.
        OutputError: the file cannot be written.
    """
    if out is not None:
        check_file(out)
    source = find_recording(recording)
    path = source.parent / FILE if out is None else Path(out)
    if out is None and source.parent.is_dir():
        check_file(path)
    read = read_recording(source)
    tables = read_tables(read, prefix)
    photos = [
        _photograph(read.latest(f"{prefix}/world/cam{n}/image/photo")["EncodedImage:blob"][0])
        for n in (1, 2)
    ]
    with atomic_write(path) as temporary:
        temporary.write_text(_html(tables, photos), encoding="utf-8")
    return path


def _photograph(blob: Any) -> str:
    """Compress a recorded photograph to a data URI of at most 1600 pixels."""
    rgb = cv2.imdecode(np.asarray(blob, dtype=np.uint8), cv2.IMREAD_COLOR)
    if rgb is None:
        raise InputError("a photograph of the recording cannot be decoded")
    factor = min(1.0, _SIDE / max(rgb.shape[:2]))
    if factor < 1:
        rgb = cv2.resize(rgb, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", rgb, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(data).decode()


def _packed(values: np.ndarray, kind: str) -> dict[str, str]:
    """Pack numbers as little-endian base64; `kind` is a NumPy code such as ``<f4``."""
    data = np.ascontiguousarray(values, dtype=kind).tobytes()
    return {"kind": kind, "data": base64.b64encode(data).decode()}


def _data(tables: Tables) -> dict[str, Any]:
    """Everything the script needs, ready for JSON."""
    m, p = tables.matches, tables.points
    fates = sorted(set(m.fate.tolist()))
    options = tables.report["options"]
    pose = tables.report["pose"]
    return {
        "words": WORDS,
        "sizes": [image["size_wh"] for image in tables.report["images"]],
        "operators": [
            {
                "name": name,
                "colour": operator_colour(name),
                "rule": matching_rule(tables, name),
                "keypoints": [
                    {
                        "xy": _packed(k.xy, "<f4"),
                        "scale": _packed(k.scale_px, "<f4"),
                        "angle": _packed(k.angle_deg, "<f4"),
                        "response": _packed(k.response, "<f4"),
                        "partner": _packed(k.partner, "<i4"),
                        "distance": _packed(k.distance, "<f4"),
                        "ratio": _packed(k.ratio, "<f4"),
                        "match": _packed(k.match, "<i4"),
                        "merged": _packed(k.merged, "|u1"),
                    }
                    for k in tables.keypoints[name]
                ],
            }
            for name in tables.operators
        ],
        "matches": {
            "kept": _packed(m.kept, "<i4"),
            "mask": _packed(m.mask, "<i4"),
            "keypoint1": _packed(m.keypoint1, "<i4"),
            "keypoint2": _packed(m.keypoint2, "<i4"),
            "fate": _packed(np.searchsorted(fates, m.fate) if fates else m.fate, "|u1"),
            "distance": _packed(m.distance_px, "<f4"),
            "point": _packed(m.point, "<i4"),
        },
        "fates": fates,
        "reasons": reasons(tables),
        "points": {
            "xyz": _packed(p.xyz, "<f4"),
            "rgb": _packed(p.rgb, "|u1"),
            "residual": _packed(p.residual_px, "<f4"),
            "parallax": _packed(p.parallax_deg, "<f4"),
            "sigma": _packed(p.sigma, "<f4"),
        },
        "radius": options["fuse"]["merge_radius"] or 0.0,
        "centre2": None
        if pose is None or pose["t"] is None
        else (-np.array(pose["R"]).T @ np.array(pose["t"])).tolist(),
    }


def _rejected(tables: Tables) -> str:
    found = rejections(tables)
    rows = [(*row, r.why) for row, r in zip(rejection_rows(tables, found), found, strict=True)]
    return page.table(
        "Keypoints of image 1 and fused matches",
        (*HEAD, "rule"),
        rows,
        right=(False, False, True, True),
        note="Examples of keypoints are pixels of image 1, others are numbers of matches, which "
        "can be entered above.",
    )


def _fusion(tables: Tables) -> str:
    """What fusion changed, per operator."""
    rows, m = [], tables.matches
    for k, name in enumerate(tables.operators):
        first = tables.keypoints[name][0]
        found = (m.mask >> k & 1).astype(bool)
        alone = found & (m.mask == 1 << k)
        counts = (
            (first.partner >= 0).sum(), first.merged.sum(), (m.kept == k).sum(), found.sum(),
            alone.sum(),
        )  # fmt: skip
        rows.append((name, *(f"{n:,}" for n in counts)))
    head = ("operator", "matches before", "merged", "kept after", "found by it", "by it alone")
    return page.table(
        "Matches before and after fusion",
        head,
        rows,
        right=(False, *[True] * 5),
        note=f"All operators together: {len(m.kept):,} matches after fusion.",
    )


def _html(tables: Tables, photos: Sequence[str]) -> str:
    code = files("sfmkit.reports").joinpath("inspector")
    report = tables.report
    names = [Path(i["path"]).name if i["path"] else "an array" for i in report["images"]]
    data = json.dumps(_data(tables), allow_nan=False).replace("<", "\\u003c")
    checks = "".join(
        f'<label><input type="checkbox" data-operator="{k}" checked>'
        f'<i style="background:{operator_colour(name)}"></i>{escape(name)}</label>'
        for k, name in enumerate(tables.operators)
    )
    stages = "".join(
        f'<option value="{value}"{" selected" if value == "after" else ""}>{words}</option>'
        for value, words in (
            ("keypoints", "all keypoints"),
            ("unmatched", "keypoints without a match"),
            ("before", "matches before fusion"),
            ("merged", "matches that fusion merged"),
            ("after", "matches after fusion"),
            ("inliers", "inliers"),
            ("rejected", "rejected matches"),
        )
    )
    figures = "".join(
        f'<figure><div class="photo" id="photo{n}"><img src="{source}" alt="photograph {n}">'
        f"<canvas></canvas></div><figcaption>image {n}: {escape(name)}</figcaption></figure>"
        for n, (source, name) in enumerate(zip(photos, names, strict=True), start=1)
    )
    cloud = (
        page.heading("Cloud")
        + '<div class="controls"><label>colour <select id="colour"><option value="photo">photograph'
        '</option><option value="operator">operator</option></select></label></div>'
        '<canvas id="scene"></canvas><p class="note">Drag to turn, scroll or use two fingers to '
        "zoom, click a point to read where it comes from. Triangles: the cameras.</p>"
        if len(tables.points.xyz)
        else page.paragraphs([f"There is no cloud: {report['verdict']['reason']}"])
    )
    view = (
        f'<div class="controls"><fieldset><legend>Operators</legend>{checks}</fieldset>'
        f'<label>show <select id="stage">{stages}</select></label>'
        '<label><input type="checkbox" id="heat">coverage as heat map</label>'
        '<span id="count"></span></div>'
        '<p class="note">Colour: the operator; a cross: a rejected match; yellow: the chosen one. '
        "Click a dot.</p>"
        '<figure id="bar" hidden><div class="ramp"></div><div class="ticks"></div>'
        "<figcaption></figcaption></figure>"
        f'<div class="stage"><div class="photos">{figures}</div>{cloud}'
        '<div class="side"><pre id="life" aria-live="polite">Click a photograph or the cloud to '
        "read what became of a keypoint, match or point.</pre>"
        '<form id="go"><label>match <input id="match" type="number" min="0"></label>'
        '<label>point <input id="point" type="number" min="0"></label><button>Show</button></form>'
        "</div></div>"
        f'<script type="application/json" id="data">{data}</script>'
    )
    return page.page(
        " + ".join(names),
        [f"Verdict: {report['verdict']['kind']}. {report['verdict']['reason']}"],
        [
            ("Keypoints, matches and points", view),
            ("Why matches were rejected", _rejected(tables)),
            ("What fusion changed", _fusion(tables)),
        ],
        style=code.joinpath("inspector.css").read_text(encoding="utf-8"),
        script=code.joinpath("inspector.js").read_text(encoding="utf-8"),
    )
