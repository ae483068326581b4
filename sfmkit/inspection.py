"""Questions to a recording, answered in text: where a point comes from, how an operator did, what differs from another.

Reads what :func:`sfmkit.viz.rerun.save_recording` wrote; see docs/recording.md for what is in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import acos, degrees
from pathlib import Path
from typing import Any

import numpy as np

from .account import ALL
from .errors import OperatorError
from .viz.recording import Recording, RecordingError, read_recording

Number = int | float | None
POINTS = "world/points/operator"


@dataclass(frozen=True)
class Sighting:
    """A keypoint behind a 3-D point.

    Attributes:
        operator, image, keypoint: the row `keypoint` of what the operator found in image 1 or 2.
        pixel: where it was found, pixels of the pinhole without distortion.
        scale_px, angle_deg: diameter and orientation of the described neighbourhood.
        kept: whether its position was used; else it was merged into the one whose was.
    """

    operator: str
    image: int
    keypoint: int
    pixel: tuple[float, float]
    scale_px: float
    angle_deg: float
    kept: bool


@dataclass(frozen=True)
class PointOrigin:
    """Where a 3-D point comes from.

    Attributes:
        point, total: its row in the cloud, and the cloud's size.
        xyz: baselines, in the frame of camera 1.
        operators: all that found it; `kept` is the one whose pixels were used.
        x1, x2: those pixels in the photographs.
        match: row of the fused correspondences.
        distance_px: to the epipolar geometry (Sampson).
        descriptor_distance, descriptor_ratio: how alike the two neighbourhoods are.
        residual_px, residual_rank: root mean square reprojection error, and the share of points that have a larger one.
        parallax_deg: angle between the two rays.
        sigma: standard deviation along the worst direction, baselines; None where it was not computed.
        sightings: the keypoints behind it, of all operators and both images.
    """

    point: int
    total: int
    xyz: tuple[float, float, float]
    operators: tuple[str, ...]
    kept: str
    x1: tuple[float, float]
    x2: tuple[float, float]
    match: int
    distance_px: float
    descriptor_distance: float
    descriptor_ratio: float
    residual_px: float
    residual_rank: float
    parallax_deg: float
    sigma: float | None
    sightings: tuple[Sighting, ...]

    def __str__(self) -> str:
        depth = self.xyz[2]
        rows = [
            ("position", f"({', '.join(f'{v:.4f}' for v in self.xyz)}) baselines, in the frame of camera 1"),
            ("found by", ", ".join(self.operators) + (f"; position of {self.kept}" if len(self.operators) > 1 else "")),
            ("image 1", f"pixel {_pixel(self.x1)}"),
            ("image 2", f"pixel {_pixel(self.x2)}"),
            ("match", f"{self.match:,}: descriptor distance {self.descriptor_distance:.4g}, {_ratio(self.descriptor_ratio)}"
             f"{self.distance_px:.3f} px from the epipolar geometry"),
            ("residual", f"{self.residual_px:.3f} px; {self.residual_rank:.0%} of the points have a larger one"),
            ("parallax", f"{self.parallax_deg:.2f} deg between the two rays"),
        ]  # fmt: skip
        if self.sigma is not None:
            rows.append(
                (
                    "uncertainty",
                    f"{self.sigma:.4g} baselines along the worst direction, {self.sigma / depth:.2%} of the depth",
                )
            )
        for s in self.sightings:
            merged = "" if s.kept else ", merged into it"
            rows.append(
                (f"keypoint {s.keypoint:,}", f"{s.operator}, image {s.image}, pixel {_pixel(s.pixel)}, scale {s.scale_px:.1f} px, "
                 f"orientation {s.angle_deg:.0f} deg{merged}")
            )  # fmt: skip
        return f"point {self.point:,} of {self.total:,}\n{_facts(rows)}"


def point_origin(recording: Recording, n: int, prefix: str = "") -> PointOrigin:
    """Follow point `n` of the cloud back to its pixels and detectors.

    Raises:
        RecordingError: the recording has no cloud, or the cloud no such point.
    """
    entity = f"{prefix}/{POINTS}"
    operators = _operators(recording, prefix)
    if entity not in recording:
        verdict = recording.report(prefix)["verdict"]["kind"]
        raise RecordingError(f"{recording.path} has no cloud; its verdict is: {verdict}")
    cloud = _ours(recording, entity)
    total = len(cloud["point"])
    if not 0 <= n < total:
        raise RecordingError(f"there is no point {n}; {recording.path} has points 0 to {total - 1}")
    xyz = recording.latest(entity)["Points3D:positions"][n]
    row, kept = int(cloud["match"][n]), operators[int(recording.latest(entity)["Points3D:class_ids"][n])]
    inliers = _ours(recording, f"{prefix}/world/cam1/image/inliers/{_name(kept)}")
    match = int(np.flatnonzero(inliers["match"] == row)[0])
    found_by = tuple(o for k, o in enumerate(operators) if int(cloud["operator_mask"][n]) >> k & 1)
    sightings = [s for o in found_by for i in (1, 2) for s in _sightings(recording, prefix, o, i, n, o == kept, cloud)]
    return PointOrigin(
        point=n,
        total=total,
        xyz=tuple(float(v) for v in xyz),  # type: ignore[arg-type]
        operators=found_by,
        kept=kept,
        x1=tuple(float(v) for v in cloud["x1"][n]),  # type: ignore[arg-type]
        x2=tuple(float(v) for v in cloud["x2"][n]),  # type: ignore[arg-type]
        match=row,
        distance_px=float(inliers["distance_px"][match]),
        descriptor_distance=float(inliers["descriptor_distance"][match]),
        descriptor_ratio=float(inliers["descriptor_ratio"][match]),
        residual_px=float(cloud["residual_px"][n]),
        residual_rank=float(np.mean(cloud["residual_px"] > cloud["residual_px"][n])),
        parallax_deg=float(cloud["parallax_deg"][n]),
        sigma=float(cloud["sigma"][n]) if "sigma" in cloud else None,
        sightings=tuple(sorted(sightings, key=lambda s: (not s.kept, s.operator, s.image))),
    )


def _sightings(
    recording: Recording, prefix: str, operator: str, image: int, n: int, is_kept: bool, cloud: dict[str, Any]
) -> list[Sighting]:
    """The keypoints of an operator that lead to point n in one image."""
    entity = f"{prefix}/world/cam{image}/image/keypoints/{_name(operator)}"
    keypoints, own = recording.latest(entity), _ours(recording, entity)
    return [
        Sighting(
            operator, image, k, (float(x), float(y)), float(own["scale_px"][k]), float(own["angle_deg"][k]),
            kept=is_kept and k == int(cloud[f"keypoint{image}"][n]),
        )
        for k in np.flatnonzero(own["point"] == n).tolist()
        for x, y in [keypoints["Points2D:positions"][k]]
    ]  # fmt: skip


def describe_point(path: str | Path, n: int, prefix: str = "") -> str:
    """Where point `n` comes from: pixels, operators, residual, angle, uncertainty."""
    return str(point_origin(read_recording(path), n, prefix))


def describe_recording(path: str | Path) -> str:
    """Verdict, pose, account and times of a recording, and what it holds."""
    recording = read_recording(path)
    prefixes = recording.prefixes()
    if not prefixes:
        recording.report()
    told = [_describe_reconstruction(recording, prefix) for prefix in prefixes]
    children = [f"  /{name}" for name in recording.below("")]
    return "\n\n".join(
        [*told, "\n".join([f"{len(recording.entities)} entities (--entity PATH tells more), below", *children])]
    )


def _describe_reconstruction(recording: Recording, prefix: str) -> str:
    report = recording.report(prefix)
    rows = [
        ("images", " and ".join(_image(i) for i in report["images"])),
        ("verdict", f"{report['verdict']['kind']}: {report['verdict']['reason']}"),
        ("pose", _pose(report)),
        ("residual", _unit(report["reprojection_rmse_px"], "px root mean square reprojection error")),
        ("made with", f"preset {report['preset']}, seed {report['seed']}, "
         + ", ".join(f"{k} {v}" for k, v in report["versions"].items())),
        ("time", ", ".join(f"{k} {v:.2f} s" for k, v in report["timings_s"].items())),
    ]  # fmt: skip
    if "errors" in report:
        rows.insert(
            3, ("error", "rotation {rotation_deg}, translation {translation_deg} deg".format(**report["errors"]))
        )
    rows += [("warning", w) for w in report["warnings"]]
    head = f"{recording.path}{f', {prefix}' if prefix else ''}"
    return f"{head}\n{_facts(rows)}\n\n{_account(report['operators'])}"


def describe_operator(path: str | Path, name: str, prefix: str = "") -> str:
    """How an operator did: its line of the account, where its keypoints ended, how good its points are.

    Raises:
        OperatorError: the recording has no such operator.
    """
    recording = read_recording(path)
    report = recording.report(prefix)
    operators = _operators(recording, prefix)
    if name not in operators:
        raise OperatorError.unknown(name, operators)
    parts = [f"{name} in {recording.path}", _account({o: report["operators"][o] for o in (name, ALL)})]
    for image in (1, 2):
        entity = f"{prefix}/world/cam{image}/image/keypoints/{_name(name)}"
        if entity in recording:
            fates = Counter(_ours(recording, entity)["fate"].tolist())
            total = fates.total()
            rows = [(fate, f"{n:,}", f"{n / total:.1%}") for fate, n in fates.most_common()]
            parts.append(_table((f"what became of its keypoints in image {image}", "", ""), rows))
    if f"{prefix}/{POINTS}" in recording:
        parts.append(_quality(recording, prefix, operators, name))
    return "\n\n".join(parts)


def _quality(recording: Recording, prefix: str, operators: Sequence[str], name: str) -> str:
    """Medians of the operator's points against those of all others."""
    cloud = _ours(recording, f"{prefix}/{POINTS}")
    mine = (cloud["operator_mask"] >> list(operators).index(name) & 1).astype(bool)
    kinds = [("residual_px", "residual, px"), ("parallax_deg", "parallax, deg"), ("sigma", "uncertainty, baselines")]
    rows = [
        (f"median {what}", *(f"{np.median(cloud[key][sel]):.4g}" if sel.any() else "-" for sel in (mine, ~mine)))
        for key, what in kinds
        if key in cloud
    ]
    return _table(("points", f"of {name} ({int(mine.sum()):,})", f"of others alone ({int((~mine).sum()):,})"), rows)


def describe_entity(path: str | Path, entity: str) -> str:
    """What an entity holds: components, how many values, their range, at which times.

    Raises:
        RecordingError: no such entity; the message names the nearest.
    """
    recording = read_recording(path)
    entity = "/" + entity.strip("/")
    children = recording.below(entity)
    if entity not in recording and children:
        return f"{entity} holds nothing itself; below it: {', '.join(children)}"
    rows = [
        (item.component, f"{len(item.values):,}", _range(item.values),
         ", ".join(f"{k} {v}" for k, v in item.times.items()) or "always")
        for item in recording.logged(entity)
    ]  # fmt: skip
    below = f"\n\nbelow it: {', '.join(children)}" if children else ""
    return f"{entity}\n\n{_table(('component', 'values', 'range', 'when'), rows, left=4)}{below}"


def diff_recordings(a: str | Path, b: str | Path, prefix: str = "") -> str:
    """What changed from recording `a` to recording `b`: settings, verdict, pose, account, points, times."""
    before, after = read_recording(a), read_recording(b)
    ra, rb = before.report(prefix), after.report(prefix)
    rows = [("", str(before.path), str(after.path))]
    for label, value in (
        ("preset", lambda r: r["preset"]),
        ("seed", lambda r: r["seed"]),
        ("image 1", lambda r: _image(r["images"][0])),
        ("image 2", lambda r: _image(r["images"][1])),
        ("focal lengths", lambda r: ", ".join(f"{c['K'][0][0]:.1f} px ({c['source']})" for c in r["camera"])),
        ("operators", lambda r: ", ".join(o for o in r["operators"] if o != ALL)),
        ("verdict", lambda r: r["verdict"]["kind"]),
        ("residual, px", lambda r: r["reprojection_rmse_px"]),
        ("error of rotation, deg", lambda r: r.get("errors", {}).get("rotation_deg")),
        ("error of translation, deg", lambda r: r.get("errors", {}).get("translation_deg")),
        ("total time, s", lambda r: r["timings_s"].get("total")),
        ("versions", lambda r: ", ".join(f"{k} {v}" for k, v in r["versions"].items())),
    ):  # fmt: skip
        if value(ra) != value(rb):
            rows.append((label, _short(value(ra)), _short(value(rb))))
    changed = (
        _table(("changed", "from", "to"), rows, left=3) if len(rows) > 1 else "The settings and results are the same."
    )
    return "\n\n".join([changed, _diff_pose(ra, rb), _diff_account(ra, rb), _diff_points(before, after, prefix)])


def _diff_pose(a: dict[str, Any], b: dict[str, Any]) -> str:
    if a["pose"] is None or b["pose"] is None:
        return f"pose: {_pose(a)}  ->  {_pose(b)}"
    Ra, Rb = (np.array(r["pose"]["R"]) for r in (a, b))
    words = f"The rotations differ by {_angle(Ra.T @ Rb):.4f} deg"
    if a["pose"]["t"] and b["pose"]["t"]:
        cosine = float(np.dot(a["pose"]["t"], b["pose"]["t"]))
        words += f", the directions of translation by {degrees(acos(max(-1.0, min(1.0, cosine)))):.4f} deg"
    return words + "."


def _diff_account(a: dict[str, Any], b: dict[str, Any]) -> str:
    rows = []
    for name in dict.fromkeys([*a["operators"], *b["operators"]]):
        lines = [r["operators"].get(name) for r in (a, b)]
        cells = []
        for key in ("matches", "initial", "inliers", "points"):
            va, vb = (0 if line is None else line[key] for line in lines)
            cells.append(f"{vb:,} ({vb - va:+,})" if va != vb else f"{vb:,}")
        rows.append((("all" if name == ALL else name), *cells))
    return _table(("operator", "matches", "fused", "inliers", "points"), rows)


def _diff_points(a: Recording, b: Recording, prefix: str) -> str:
    """How many points rest on the same pixels in both, and how far those moved."""
    entity = f"{prefix}/{POINTS}"
    if entity not in a or entity not in b:
        return "points: not both have a cloud."
    where = []
    for recording in (a, b):
        cloud = _ours(recording, entity)
        keys = np.round(np.hstack([cloud["x1"], cloud["x2"]]) * 100).astype(np.int64)  # a hundredth of a pixel
        xyz = recording.latest(entity)["Points3D:positions"]
        where.append({tuple(key): p for key, p in zip(keys.tolist(), xyz)})
    both = where[0].keys() & where[1].keys()
    only = [len(w) - len(both) for w in where]
    words = f"{len(both):,} points rest on the same pixels in both, {only[0]:,} are gone, {only[1]:,} are new."
    if both:
        moved = np.median([np.linalg.norm(where[0][k] - where[1][k]) for k in both])
        words += f" The common ones moved by {moved:.4g} baselines (median)."
    return words


def _operators(recording: Recording, prefix: str) -> tuple[str, ...]:
    """The operators of a reconstruction; bit and class id k is the k-th."""
    return tuple(name for name in recording.report(prefix)["operators"] if name != ALL)


def _ours(recording: Recording, entity: str) -> dict[str, Any]:
    """Our own columns of an entity, by their bare names."""
    start = "sfmkit:"
    return {c.removeprefix(start): v for c, v in recording.latest(entity).items() if c.startswith(start)}


def _name(operator: str) -> str:
    """An operator's name as part of an entity path, where the viewer escapes some characters."""
    return "".join(c if c.isalnum() or c in "-_." else f"\\{c}" for c in operator)


def _angle(R: np.ndarray) -> float:
    """Angle of a rotation, degrees; precise for small ones."""
    return degrees(2 * np.arcsin(min(1.0, float(np.linalg.norm(R - np.eye(3))) / 8**0.5)))


def _pose(report: dict[str, Any]) -> str:
    pose = report["pose"]
    if pose is None:
        return "none"
    words = f"rotation {_angle(np.array(pose['R'])):.3f} deg"
    if pose["t"] is not None:
        words += ", translation direction (" + ", ".join(f"{v:+.4f}" for v in pose["t"]) + ")"
    if pose["sigma_deg"] is not None:
        words += " +- {:.3f} deg, {:.3f} deg".format(*pose["sigma_deg"])
    return words


def _image(image: dict[str, Any]) -> str:
    w, h = image["size_wh"]
    return f"{Path(image['path']).name if image['path'] else 'an array'} ({w} x {h})"


def _unit(value: Number, unit: str) -> str:
    return "none" if value is None else f"{value:.3f} {unit}"


def _ratio(value: float) -> str:
    return f"{value:.2f} of the second best, " if np.isfinite(value) else ""


def _pixel(x: Iterable[float]) -> str:
    return "(" + ", ".join(f"{v:.2f}" for v in x) + ")"


def _short(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _range(values: np.ndarray | list) -> str:
    """Smallest to largest value of numbers, the commonest of texts."""
    if isinstance(values, list) or not len(values):
        return ""
    if values.dtype.kind in "US":
        common = Counter(v.splitlines()[0][:40] for v in values.tolist() if v).most_common(4)
        return ", ".join(f"{v} ({n:,})" if len(values) > 1 else v for v, n in common)
    if not np.isfinite(values).any():
        return "no number"
    if values.ndim == 2 and values.shape[1] <= 4:
        return " ".join(f"{low:.4g}..{high:.4g}" for low, high in zip(np.nanmin(values, 0), np.nanmax(values, 0)))
    low, high = np.nanmin(values), np.nanmax(values)
    return f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"


def _account(lines: dict[str, Any]) -> str:
    rows = [
        ("all" if name == ALL else name,
         *(f"{v:,}" for v in (*a["keypoints"], a["matches"], a["initial"], a["inliers"], a["points"], a["points_alone"])),
         f"{a['share_points']:.1%}", f"{a['loss']:.1%}")
        for name, a in lines.items()
    ]  # fmt: skip
    head = ("operator", "keypoints 1", "keypoints 2", "matches", "fused", "inliers", "points", "alone", "share", "loss")
    return _table(head, rows)


def _facts(rows: Sequence[tuple[str, str]]) -> str:
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"  {label:<{width}}  {value}" for label, value in rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Aligned columns, the first `left` to the left and the others to the right."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    lines = [
        "  ".join(
            f"{cell:<{w}}" if i < left else f"{cell:>{w}}" for i, (cell, w) in enumerate(zip(row, widths))
        ).rstrip()
        for row in (head, *rows)
    ]
    return "\n".join(lines)
