"""Numbers, poses, images and tables in text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from ...pipeline.account import ALL, HEAD, account_cells

Number = int | float | None


def angle_deg(R: np.ndarray) -> float:
    """Angle of a rotation, degrees; precise for small ones."""
    return degrees(2 * np.arcsin(min(1.0, float(np.linalg.norm(R - np.eye(3))) / 8**0.5)))


def pose_words(report: dict[str, Any]) -> str:
    pose = report["pose"]
    if pose is None:
        return "none"
    words = f"rotation {angle_deg(np.array(pose['R'])):.3f} deg"
    if pose["t"] is not None:
        words += ", translation direction (" + ", ".join(f"{v:+.4f}" for v in pose["t"]) + ")"
    if pose["sigma_deg"] is not None:
        words += " +- {:.3f} deg, {:.3f} deg".format(*pose["sigma_deg"])
    return words


def image_words(image: dict[str, Any]) -> str:
    w, h = image["size_wh"]
    return f"{Path(image['path']).name if image['path'] else 'an array'} ({w} x {h})"


def with_unit(value: Number, unit: str) -> str:
    return "none" if value is None else f"{value:.3f} {unit}"


def short(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def range_words(values: np.ndarray | list) -> str:
    """Smallest to largest value of numbers, the commonest of texts."""
    if isinstance(values, list) or not len(values):
        return ""
    if values.dtype.kind in "US":
        common = Counter(v.splitlines()[0][:40] for v in values.tolist() if v).most_common(4)
        return ", ".join(f"{v} ({n:,})" if len(values) > 1 else v for v, n in common)
    if not np.isfinite(values).any():
        return "no number"
    if values.ndim == 2 and values.shape[1] <= 4:
        return " ".join(
            f"{low:.4g}..{high:.4g}"
            for low, high in zip(np.nanmin(values, 0), np.nanmax(values, 0))
        )
    low, high = np.nanmin(values), np.nanmax(values)
    return f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"


def account_table(lines: dict[str, Any]) -> str:
    return table(
        HEAD, [account_cells("all" if name == ALL else name, a) for name, a in lines.items()]
    )


def facts(rows: Sequence[tuple[str, str]]) -> str:
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"  {label:<{width}}  {value}" for label, value in rows)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Aligned columns, the first `left` to the left and the others to the right."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    lines = [
        "  ".join(
            f"{cell:<{w}}" if i < left else f"{cell:>{w}}"
            for i, (cell, w) in enumerate(zip(row, widths))
        ).rstrip()
        for row in (head, *rows)
    ]
    return "\n".join(lines)
