"""The contents of a recording, of one of its operators and of one of its entities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import OperatorError
from ...pipeline.account import ALL
from ..read import Recording, read_recording
from ._columns import POINTS, escaped, operators_of, own_columns
from ._words import account_table, facts, image_words, pose_words, range_words, table, with_unit


def describe_recording(path: str | Path) -> str:
    """Describe verdict, pose, per-operator statistics, times and entities of a recording."""
    recording = read_recording(path)
    prefixes = recording.prefixes()
    if not prefixes:
        recording.report()
    told = [_describe_reconstruction(recording, prefix) for prefix in prefixes]
    children = [f"  /{name}" for name in recording.below("")]
    return "\n\n".join(
        [
            *told,
            "\n".join(
                [
                    f"{len(recording.entities)} entities (list one with --entity PATH), below",
                    *children,
                ]
            ),
        ]
    )


def _describe_reconstruction(recording: Recording, prefix: str) -> str:
    report = recording.report(prefix)
    rows = [
        ("images", " and ".join(image_words(i) for i in report["images"])),
        ("verdict", f"{report['verdict']['kind']}: {report['verdict']['reason']}"),
        ("pose", pose_words(report)),
        (
            "residual",
            with_unit(report["reprojection_rmse_px"], "px root mean square reprojection error"),
        ),
        (
            "made with",
            f"preset {report['options']['name']}, seed {report['seed']}, "
            + ", ".join(f"{k} {v}" for k, v in report["versions"].items()),
        ),
        ("time", ", ".join(f"{k} {v:.2f} s" for k, v in report["timings_s"].items())),
    ]
    if "errors" in report:
        rows.insert(
            3,
            (
                "error",
                "rotation {rotation_deg:.3f}, "
                "translation direction {translation_deg:.3f} deg".format(**report["errors"]),
            ),
        )
    rows += [("warning", w) for w in report["warnings"]]
    head = f"{recording.path}{f', {prefix}' if prefix else ''}"
    return f"{head}\n{facts(rows)}\n\n{account_table(report['operators'])}"


def describe_operator(path: str | Path, name: str, prefix: str = "") -> str:
    """Describe one operator: its statistics, the fate of its keypoints, the quality of its points.

    Raises:
        OperatorError: the recording has no such operator.
    """
    recording = read_recording(path)
    report = recording.report(prefix)
    operators = operators_of(recording, prefix)
    if name not in operators:
        raise OperatorError.unknown(name, operators)
    parts = [
        f"{name} in {recording.path}",
        account_table({o: report["operators"][o] for o in (name, ALL)}),
    ]
    for image in (1, 2):
        entity = f"{prefix}/world/cam{image}/image/keypoints/{escaped(name)}"
        if entity in recording:
            fates = Counter(own_columns(recording, entity)["fate"].tolist())
            total = fates.total()
            rows = [(fate, f"{n:,}", f"{n / total:.1%}") for fate, n in fates.most_common()]
            parts.append(table((f"fate of its keypoints in image {image}", "", ""), rows))
    if f"{prefix}/{POINTS}" in recording:
        parts.append(_quality(recording, prefix, operators, name))
    return "\n\n".join(parts)


def _quality(recording: Recording, prefix: str, operators: Sequence[str], name: str) -> str:
    """Medians of the operator's points and of all other points."""
    cloud = own_columns(recording, f"{prefix}/{POINTS}")
    mine = (cloud["operator_mask"] >> list(operators).index(name) & 1).astype(bool)
    kinds = [
        ("residual_px", "residual, px"),
        ("parallax_deg", "parallax, deg"),
        ("sigma", "uncertainty, baselines"),
    ]
    rows = [
        (
            f"median {what}",
            *(f"{np.median(cloud[key][sel]):.4g}" if sel.any() else "-" for sel in (mine, ~mine)),
        )
        for key, what in kinds
        if key in cloud
    ]
    return table(
        ("points", f"of {name} ({int(mine.sum()):,})", f"of others alone ({int((~mine).sum()):,})"),
        rows,
    )


def describe_entity(path: str | Path, entity: str) -> str:
    """List the components of an entity: number of values, their range and times.

    Raises:
        RecordingError: no such entity; the message names the nearest.
    """
    recording = read_recording(path)
    entity = "/" + entity.strip("/")
    children = recording.below(entity)
    if entity not in recording and children:
        return f"{entity} has no values; below it: {', '.join(children)}"
    rows = [
        (
            item.component,
            f"{len(item.values):,}",
            range_words(item.values),
            ", ".join(f"{k} {v}" for k, v in item.times.items()) or "always",
        )
        for item in recording.logged(entity)
    ]
    below = f"\n\nbelow it: {', '.join(children)}" if children else ""
    return f"{entity}\n\n{table(('component', 'values', 'range', 'when'), rows, left=4)}{below}"
