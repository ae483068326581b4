"""The report of a reconstruction, ``report.json``.

Its schema is ``report.schema.json`` in this folder.
"""

from __future__ import annotations

import json
import math
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from .._utils.versions import versions
from ..options import as_plain

if TYPE_CHECKING:
    from ..types import Camera
    from .reconstruction import Reconstruction

SCHEMA_VERSION = 2


def schema() -> dict[str, Any]:
    """Read the JSON Schema (draft 2020-12) of reports."""
    return json.loads(files("sfmkit.pipeline").joinpath("report.schema.json").read_text())


def _numbers(value: Any) -> Any:
    """Convert tensors and arrays to nested lists, and values that are not finite to None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {name: _numbers(v) for name, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_numbers(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        "K": _numbers(camera.K),
        "distortion": _numbers(camera.distortion),
        "size_wh": list(camera.size_wh),
        "source": camera.source,
        "sigma": {
            "focal": camera.uncertainty.focal,
            "principal_point_px": camera.uncertainty.principal_point,
            "k1": camera.uncertainty.k1,
        },
    }


def make_report(result: Reconstruction) -> dict[str, Any]:
    """Make the report of a reconstruction as plain Python, ready for :func:`json.dumps`."""
    view = result.two_view
    report: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "images": [
            {"path": str(i.path) if i.path else None, "size_wh": list(i.size_wh)}
            for i in result.images
        ],
        "camera": [_camera(view.camera1), _camera(view.camera2)],
        "options": _numbers(as_plain(result.options)),
        "plugins": {kind: dict(used) for kind, used in result.plugins.items()},
        "seed": result.seed,
        "operators": {name: _numbers(line.as_dict()) for name, line in result.account.items()},
        "verdict": {
            "kind": view.verdict.value,
            "reason": view.reason,
            "evidence": {k: _numbers(float(v)) for k, v in view.evidence.items()},
        },
        "pose": None
        if view.R is None
        else {
            "R": _numbers(view.R),
            "t": None if view.t is None else _numbers(view.t),
            "sigma_deg": None if view.sigma_deg is None else _numbers(list(view.sigma_deg)),
            "sigma_parts_deg": {k: _numbers(list(v)) for k, v in view.sigma_parts_deg.items()},
            "alternatives": [{"R": _numbers(R), "t": _numbers(t)} for R, t in view.alternatives],
        },
        "reprojection_rmse_px": _numbers(result.reprojection_rmse_px),
        "timings_s": {k: round(v, 4) for k, v in result.timings_s.items()},
        "warnings": list(result.warnings),
        "versions": versions(),
    }
    if result.errors is not None:
        report["errors"] = {k: _numbers(v) for k, v in result.errors.items()}
    return report
