"""The table of a sweep: one row for each pair, combination, preset and seed.

``docs/ablation.md`` describes them; :data:`~.table_file.SCHEMA` lists their types.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch

from ..errors import InputError
from ..geometry.pose import rotation_error, translation_error
from ..metrics import check_point_error, corner_error, homography_rmse
from ..types import Verdict
from .sources import PlannedPair
from .table_file import SCHEMA, read_shard
from .tasks import EstimateTask, Job
from .variants import JOIN

TABLE = "ablation.parquet"

# Two runs of one sweep differ in these columns only.
VOLATILE = (
    "seconds_detect",
    "seconds_match",
    "seconds_fuse",
    "seconds_estimate",
    "seconds",
    "peak_memory_mb",
    "machine",
)

OK, NO_ESTIMATE, FAILED = "ok", "no estimate", "failed"

Row = dict[str, Any]


def make_row(
    pair: PlannedPair, unit: EstimateTask, job: Job, result: Mapping[str, Any] | str
) -> Row:
    """Make the row of a job.

    Args:
        result: The result of the estimate, or the reason why there is none.
    """
    row: Row = dict.fromkeys(SCHEMA.names)
    row |= {
        "dataset": pair.dataset,
        "sequence": pair.sequence,
        "pair": pair.name,
        "kind": "homography" if pair.homography else "two-view",
        "has_truth": pair.has_truth,
        "combination": JOIN.join(job.combination),
        "operators": list(job.combination),
        "n_operators": len(job.combination),
        "preset": unit.variant.preset,
        "vary": unit.variant.vary,
        "seed": job.seed,
        "error_unit": "px" if pair.homography else "deg",
    }
    if isinstance(result, str):
        return row | {"status": FAILED, "failure": result}
    seconds, versions = result["seconds"], result["versions"]
    row |= {
        "keypoints1": result["keypoints"][0],
        "keypoints2": result["keypoints"][1],
        "matches": result["matches"],
        "correspondences": result["correspondences"],
        "inliers": result["inliers"],
        "guided": result["guided"],
        "status": NO_ESTIMATE if result["verdict"] == Verdict.TOO_LITTLE else OK,
        "verdict": result["verdict"],
        "reason": result["reason"],
        "H": result["H"],
        "R": result["R"],
        "t": result["t"],
        **{f"seconds_{stage}": s for stage, s in seconds.items()},
        "seconds": sum(seconds.values()),
        "peak_memory_mb": result["peak_mb"],
        "versions": ", ".join(f"{name} {v}" for name, v in versions.items()),
        "machine": result["machine"],
    }
    return row | (_errors(pair, row) if pair.has_truth else {})


def _errors(pair: PlannedPair, row: Row) -> Row:
    """Compute errors against the truth; infinite if there is no estimate.

    The error of a homography is that of its check points if there are some, else that of the
    corners of image 1.
    """
    if pair.homography:
        if row["H"] is None:
            return {"error": math.inf}
        H = np.array(row["H"]).reshape(3, 3)
        found: Row = {}
        if pair.H is not None and pair.images is not None:
            found["corner_error_px"] = corner_error(H, pair.H, pair.images[0].size_wh)
            found["rmse"] = homography_rmse(H, pair.H)
        if pair.check_points is not None:
            found["check_error_px"] = check_point_error(H, pair.check_points)
        return found | {"error": found.get("check_error_px", found.get("corner_error_px"))}
    assert pair.R is not None
    assert pair.t is not None
    if row["R"] is None:
        return {"error": math.inf}
    rotation = float(
        rotation_error(
            torch.tensor(row["R"], dtype=torch.float64).reshape(3, 3), torch.tensor(pair.R)
        )
    )
    if not np.any(pair.t):  # the camera did not move, so the translation has no direction
        return {"rotation_deg": rotation, "error": rotation}
    if row["t"] is None:
        return {"rotation_deg": rotation, "error": math.inf}
    translation = float(
        translation_error(torch.tensor(row["t"], dtype=torch.float64), torch.tensor(pair.t))
    )
    return {
        "rotation_deg": rotation,
        "translation_deg": translation,
        "error": max(rotation, translation),
    }


@dataclass(frozen=True, eq=False)
class AblationTable:
    """The rows of a sweep.

    Attributes:
        data: a pyarrow table with :data:`~.table_file.SCHEMA`.
        path: the Parquet file, None where it was not written.
    """

    data: pa.Table
    path: Path | None = None

    def __len__(self) -> int:
        return self.data.num_rows

    def __iter__(self) -> Iterator[Row]:
        for batch in self.data.to_batches(max_chunksize=1000):
            yield from batch.to_pylist()

    def __getitem__(self, column: str) -> list[Any]:
        if column not in self.data.column_names:
            raise InputError(
                f"there is no column '{column}'; there are {', '.join(self.data.column_names)}"
            )
        return self.data[column].to_pylist()

    def __repr__(self) -> str:
        states = {
            s: int(pc.sum(pc.equal(self.data["status"], s)).as_py() or 0)
            for s in (OK, NO_ESTIMATE, FAILED)
        }
        pairs = len(
            {
                (r["dataset"], r["sequence"], r["pair"])
                for r in self.data.select(["dataset", "sequence", "pair"]).to_pylist()
            }
        )
        combos = len(pc.unique(self.data["combination"]))
        words = ", ".join(f"{n:,} {state}" for state, n in states.items() if n)
        return f"AblationTable({len(self):,} rows: {pairs} pairs, {combos} combinations; {words})"

    def rows_of(self, columns: Sequence[str]) -> Iterator[Row]:
        """Yield the rows with some of the columns only."""
        for batch in self.data.select(list(columns)).to_batches(max_chunksize=1000):
            yield from batch.to_pylist()

    def results(self) -> pa.Table:
        """Without the columns in which two runs of one sweep differ."""
        return self.data.drop_columns(list(VOLATILE))

    def to_pandas(self):
        """A pandas DataFrame, where pandas is installed."""
        return self.data.to_pandas()


def table_of(rows: Sequence[Row]) -> pa.Table:
    return pa.Table.from_pylist(list(rows), schema=SCHEMA)


def read_table(path: str | os.PathLike) -> AblationTable:
    """Read the table of a sweep: its Parquet file, or the folder that holds it.

    Raises:
        InputError: There is none, or it is damaged; see :func:`read_shard`.
    """
    file = check_table(path)
    return AblationTable(read_shard(file), file)


def check_table(path: str | os.PathLike) -> Path:
    """Return the file that :func:`read_table` reads.

    Raises:
        InputError: There is none.
    """
    file = Path(path)
    file = file / TABLE if file.is_dir() else file
    if not file.is_file():
        raise InputError(
            f"there is no {file}; `sfmkit ablate ... --out {Path(path)}` writes it, and completes "
            "an interrupted sweep"
        )
    return file
