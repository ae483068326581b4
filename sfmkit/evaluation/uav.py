"""Drone benchmark: a small shift and a wide baseline, compared with COLMAP and other programs."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
import torch

from .._utils.progress import Progress
from .._utils.writing import check_folder
from .._version import __version__
from ..datasets.pair import Pair
from ..datasets.uav import uav
from ..errors import InputError, SfmError
from ..features import choose_operators
from ..geometry.reprojection import project
from ..io.cameras import camera_from_exif
from ..io.images import read_image
from ..io.ply import read_ply, write_ply
from ..matching import canonical_matchers
from ..options import PRESETS, Options, adjust_preset
from ..pipeline.account import ALL
from ..pipeline.reconstruction import reconstruct
from ..pipeline.stages import OPERATORS_OF_THE_PAPER, choose_options
from ..types import Camera, PointCloud
from . import colmap_peer
from .rows import Row, RowStore
from .settings import plugin_settings

SMALL, WIDE = "small shift", "wide baseline"
WIDE_STEP = 4  # distance of the photographs of a wide pair in the sequence, if it is long enough
PAIR_OF, ALL_OF = "2", "all"  # photographs that COLMAP reconstructs

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Flight:
    """The photographs of a flight, its pairs per case, and the camera.

    The first pair of each case starts with the first photograph.
    """

    photographs: tuple[Path, ...]
    cases: dict[str, list[Pair]]
    camera: Camera


def open_flight(data: str | os.PathLike | None, sequence: str | None, step: int | None) -> Flight:
    """Open a sequence of drone photographs, with the camera from EXIF.

    Args:
        data: Folder of the data sets.
        sequence: Name of the sequence; None for the first one.
        step: Distance of the photographs of a wide pair; the other pairs are neighbours.

    Raises:
        InputError: The data are missing, there are too few photographs, `step` is less than 2, or
            EXIF has no focal length.
    """
    near = list(uav(data, None if sequence is None else [sequence]))
    near = [pair for pair in near if pair.sequence == near[0].sequence]
    photographs = (near[0].image1, *(pair.image2 for pair in near))
    if step is not None and step < 2:
        raise InputError(f"a wide baseline takes photographs at least 2 apart, not {step}")
    step = min(WIDE_STEP, len(photographs) - 1) if step is None else step
    cases = {SMALL: near}
    if step > 1:
        cases[WIDE] = list(uav(data, [near[0].sequence], step))
    camera = camera_from_exif(read_image(photographs[0]))  # type: ignore[arg-type]
    return Flight(photographs, cases, camera)  # type: ignore[arg-type]


def parse_box(text: str | None, size_wh: tuple[int, int]) -> Box:
    """Parse a box ``X0,Y0,X1,Y1`` in pixels of the first photograph.

    Args:
        text: The box; None for the middle third of the photograph in both directions.
        size_wh: Width and height of the photograph, pixels.

    Raises:
        InputError: The text is not four numbers, or the box is empty or outside the photograph.
    """
    w, h = size_wh
    if text is None:
        return (w / 3, h / 3, 2 * w / 3, 2 * h / 3)
    try:
        x0, y0, x1, y1 = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(
            "--box takes four numbers X0,Y0,X1,Y1, left, top, right and bottom in pixels of the "
            "first photograph, e.g. "
            f"{w // 3},{h // 3},{2 * w // 3},{2 * h // 3}; not {text!r}"
        ) from None
    if not all(math.isfinite(v) for v in (x0, y0, x1, y1)) or not (x0 < x1 and y0 < y1):
        raise InputError(f"--box {text} is empty: X0 must be less than X1, and Y0 less than Y1")
    if x1 <= 0 or y1 <= 0 or x0 >= w or y0 >= h:
        raise InputError(
            f"--box {text} lies outside the first photograph, which has {w} x {h} pixels"
        )
    return (x0, y0, x1, y1)


def inside_box(cloud: PointCloud, camera: Camera, box: Box) -> np.ndarray:
    """Return (M,) bool: points in front of camera 1 that are projected into the box."""
    X = cloud.xyz
    ahead = X[:, 2] > 0
    x = project(torch.where(ahead[:, None], X, torch.ones_like(X)), camera.tensors()[0])
    x0, y0, x1, y1 = box
    inside = ahead & (x[:, 0] >= x0) & (x[:, 0] <= x1) & (x[:, 1] >= y0) & (x[:, 1] <= y1)
    return inside.numpy()


def bench_uav(
    out: str | os.PathLike,
    *,
    data: str | os.PathLike | None = None,
    sequence: str | None = None,
    step: int | None = None,
    box: str | None = None,
    operators: Sequence[str] = OPERATORS_OF_THE_PAPER,
    matchers: str | Mapping[str, str] | None = None,
    backend: str | None = None,
    presets: Sequence[str] = ("default", "dense"),
    max_size: int | None = None,
    colmap: bool = True,
    clouds: Sequence[str | os.PathLike] = (),
    progress: Progress | None = None,
) -> list[Row]:
    """Run the missing parts of the benchmark and return all of its rows.

    Args:
        out: Folder for ``rows.jsonl`` and the clouds of the first pairs as PLY.
        data, sequence: As for :func:`sfmkit.datasets.uav.uav`; None for the first flight that is
            present.
        step: Distance of the photographs of a wide pair in the sequence; None for 4, or for the
            number of photographs less one if that is smaller.
        box: Target in the first photograph, see :func:`parse_box`.
        operators: At least one; they run together.
        matchers: Matcher of all operators, or a mapping operator -> matcher; None for those of
            the presets.
        backend: Robust estimator; None for those of the presets.
        presets: Names of :data:`sfmkit.options.PRESETS`: all run on the first pair of each case,
            the first one on the other pairs.
        max_size: Longest side, pixels, at which the photographs are searched; None for full size.
        colmap: Also run COLMAP on the first pair of each case and on all photographs.
        clouds: PLY files of the same scene from other programs.
        progress: Called with (stage, detail) and the fraction of the work that is done.

    Returns:
        Rows of three kinds: ``pair`` (case, pair, preset -> verdict, initial, points, target,
        seconds), ``colmap`` (case, given -> images, points, target, seconds; ``missing`` if
        pycolmap is not installed) and ``given`` (file, case -> points, target, note).

    Raises:
        InputError: The data are missing, an operator, matcher, estimator or preset is unknown, the
            estimator cannot estimate the model of a preset, the box or a cloud is invalid, or the
            rows in `out` come from other settings.
    """
    check_folder(out)
    operators = choose_operators(operators)
    matchers = canonical_matchers(matchers)
    recipes = {
        name: choose_options(
            adjust_preset(name, backend=backend, max_size=max_size), operators, matchers=matchers
        )
        for name in presets
    }
    if not recipes:
        raise InputError(f"name at least one preset: {', '.join(PRESETS)}")
    flight = open_flight(data, sequence, step)
    target = parse_box(box, flight.camera.size_wh)
    given = {str(path): read_ply(path) for path in clouds}
    settings = {
        "version": __version__,
        **plugin_settings(
            operators, next(iter(recipes.values())), matchers=matchers, backend=backend
        ),
        "max_size": max_size,
        "box": list(target),
        "sequence": flight.cases[SMALL][0].sequence,
        "photographs": len(flight.photographs),
    }
    out = Path(out)
    store = RowStore(out / "rows.jsonl", settings)
    rows = store.read()
    have = {(r["kind"], r["case"], r.get("pair", r.get("given")), r.get("preset")) for r in rows}
    parts: list[tuple[str, str, Pair | str, str | None]] = [
        ("pair", case, pair, preset)
        for case, pairs in flight.cases.items()
        for pair in pairs
        for preset in (presets if pair is pairs[0] else presets[:1])
    ]
    if colmap:
        parts += [("colmap", case, PAIR_OF, None) for case in flight.cases] + [
            ("colmap", SMALL, ALL_OF, None)
        ]
    for done, (kind, case, what, preset) in enumerate(parts):
        label = what.name if isinstance(what, Pair) else what
        if progress is not None:
            which = f"{label}, {preset}" if preset else f"COLMAP, {label} photographs"
            progress("uav", f"{case}, {which}", fraction=done / len(parts))
        if (kind, case, label, preset) in have:
            continue
        if isinstance(what, Pair):
            first = what is flight.cases[case][0]
            row = _pair_row(
                case,
                what,
                operators,
                recipes[str(preset)],
                target,
                flight.camera,
                out if first else None,
            )
        else:
            row = _colmap_row(case, what, flight, target, out)
        if "missing" not in row:  # otherwise COLMAP runs when the benchmark is resumed
            store.append([row])
        rows.append(row)
    rows = [
        r for r in rows if r.get("preset") in (None, *presets) and (colmap or r["kind"] != "colmap")
    ]
    for path, cloud in given.items():
        rows += _given_rows(Path(path), cloud, flight, presets, target, out)
    if progress is not None:
        progress("uav", fraction=1.0)
    return rows


def ply_name(case: str, what: str) -> str:
    """Return the file name of a cloud of the first pair of a case, by a preset or COLMAP."""
    return f"{case.replace(' ', '-')}-{what}.ply"


def _pair_row(
    case: str,
    pair: Pair,
    operators: Sequence[str],
    options: Options,
    box: Box,
    camera: Camera,
    out: Path | None,
) -> Row:
    result = reconstruct(pair.image1, pair.image2, operators=operators, options=options)
    cloud, line = result.cloud, result.account[ALL]
    row: Row = {
        "kind": "pair",
        "case": case,
        "pair": pair.name,
        "preset": options.name,
        "verdict": result.two_view.verdict.value,
        "camera": camera.source,
        "size_wh": list(camera.size_wh),
        "initial": line.initial,
        "points": line.points,
        "target": None,
        "reprojection_rmse_px": result.reprojection_rmse_px,
        "sigma_deg": None if (sigma := result.two_view.sigma_deg) is None else list(sigma),
        "seconds": result.timings_s["total"],
    }
    if out is not None and cloud is not None and len(cloud):
        row["target"] = int(inside_box(cloud, camera, box).sum())
        write_ply(out / ply_name(case, options.name), cloud)
    return row


def _colmap_row(case: str, given: str, flight: Flight, box: Box, out: Path) -> Row:
    first = flight.cases[case][0]
    images = [first.image1, first.image2]
    if given == ALL_OF:
        images += [path for path in flight.photographs if path not in images]
    row: Row = {
        "kind": "colmap",
        "case": case,
        "given": given,
        "images": [0, len(images)],
        "points": None,
        "target": None,
    }
    try:
        model = colmap_peer.reconstruct(images, flight.camera)  # type: ignore[arg-type]
    except InputError as error:
        return row | {"missing": str(error)}
    row |= {"images": list(model.images), "seconds": dict(model.seconds), "points": 0}
    if model.cloud is not None:
        row |= {
            "points": len(model.cloud),
            "target": int(inside_box(model.cloud, flight.camera, box).sum()),
        }
        write_ply(out / ply_name(case, f"colmap-{given}"), model.cloud)
    return row


def _given_rows(
    path: Path, cloud: PointCloud, flight: Flight, presets: Sequence[str], box: Box, out: Path
) -> list[Row]:
    """Register a cloud of another program with the cloud of each case, and count its points.

    The clouds of the cases are in the frame of camera 1. The registration includes the scale.
    """
    from ..clouds.alignment import align

    rows = []
    for case in flight.cases:
        row: Row = {
            "kind": "given",
            "case": case,
            "file": path.name,
            "points": len(cloud),
            "target": None,
        }
        ours = next(
            (out / ply_name(case, p) for p in presets if (out / ply_name(case, p)).exists()), None
        )
        if ours is None:
            rows.append(row | {"note": "there is no cloud of sfmkit to register it with"})
            continue
        try:
            found = align(read_ply(ours).xyz.numpy(), cloud.xyz.numpy())
        except SfmError as error:
            rows.append(row | {"note": f"could not be registered: {error}"})
            continue
        moved = changed(cloud, xyz=found.similarity.apply(cloud.xyz), covariance=None)
        write_ply(out / ply_name(case, f"given-{path.stem}"), moved)
        how = (
            f"registered, scaled by {float(found.similarity.s):.3g}, {found.overlap[1]:.0%} of it "
            "overlaps"
        )
        doubt = "; doubtful, check the picture" if found.doubtful else ""
        rows.append(
            row | {"target": int(inside_box(moved, flight.camera, box).sum()), "note": how + doubt}
        )
    return rows
