"""Table of the pairs of a folder; docs/folders.md describes its columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from .._utils.writing import atomic_write

__all__ = ["FAILED", "make_pair_row", "pair_schema", "pair_table_of", "write_pair_table"]

FAILED = "failed"
_TEXT, _COUNT, _NUMBER = pa.string(), pa.int64(), pa.float64()
_PER_OPERATOR = ("keypoints1", "keypoints2", "matches", "inliers")
_POSE = (*(f"R{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)), "t1", "t2", "t3")


def pair_schema(operators: Sequence[str]) -> pa.Schema:
    """Return the columns of the table. Every cell of the CSV file is one number or one text."""
    columns = [
        ("image1", _TEXT),
        ("image2", _TEXT),
        ("verdict", _TEXT),
        ("reason", _TEXT),
        ("failure", _TEXT),
        ("matches", _COUNT),
        ("correspondences", _COUNT),
        ("inliers", _COUNT),
        *((f"{what}_{name}", _COUNT) for name in operators for what in _PER_OPERATOR),
        *((name, _NUMBER) for name in _POSE),
        ("sigma_rotation_deg", _NUMBER),
        ("sigma_translation_deg", _NUMBER),
        ("ambiguous_poses", _COUNT),
        ("seconds_match", _NUMBER),
        ("seconds_estimate", _NUMBER),
    ]
    return pa.schema(columns)


def make_pair_row(names: tuple[str, str], result: Mapping[str, Any] | str) -> dict[str, Any]:
    """Make the row of a pair.

    Args:
        names: Names of the two photographs.
        result: ``meta`` of :func:`sfmkit.ablation.geometries.make_geometry`, or the reason of the
            failure.
    """
    row: dict[str, Any] = {"image1": names[0], "image2": names[1]}
    if isinstance(result, str):
        return row | {"verdict": FAILED, "failure": result}
    counts = result["operators"]
    row |= {
        "verdict": result["verdict"],
        "reason": result["reason"],
        "matches": sum(line["matches"] for line in counts.values()),
        "correspondences": result["correspondences"],
        "inliers": result["inliers"],
        "ambiguous_poses": result["alternatives"],
        "seconds_match": result["seconds"]["match"],
        "seconds_estimate": result["seconds"]["estimate"],
    }
    for name, line in counts.items():
        row[f"keypoints1_{name}"], row[f"keypoints2_{name}"] = line["keypoints"]
        row[f"matches_{name}"], row[f"inliers_{name}"] = line["matches"], line["inliers"]
    pose = [*(result["R"] or [None] * 9), *(result["t"] or [None] * 3)]
    row |= dict(zip(_POSE, pose))
    if result["sigma_deg"] is not None:
        row["sigma_rotation_deg"], row["sigma_translation_deg"] = result["sigma_deg"]
    return row


def pair_table_of(rows: Iterable[Mapping[str, Any]], operators: Sequence[str]) -> pa.Table:
    """Convert rows to a table; missing values are null."""
    schema = pair_schema(operators)
    return pa.Table.from_pylist([dict.fromkeys(schema.names) | dict(row) for row in rows], schema)


def write_pair_table(table: pa.Table, folder: Path) -> None:
    """Write ``pairs.parquet`` and ``pairs.csv`` into a folder.

    Raises:
        OutputError: They cannot be written.
    """
    with atomic_write(folder / "pairs.parquet") as temporary:
        pyarrow.parquet.write_table(table, temporary)
    with atomic_write(folder / "pairs.csv") as temporary:
        pyarrow.csv.write_csv(table, temporary)
