"""The table that a sweep makes: one row for each pair, combination, preset and seed. Its columns
are its interface.

``docs/ablation.md`` describes them; :data:`SCHEMA` is what is written.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import torch

from .._utils.writing import atomic_write
from ..errors import InputError
from ..geometry.pose import rotation_error, translation_error
from ..metrics import check_point_error, corner_error, homography_rmse
from ..types import Verdict
from .sources import PlannedPair
from .tasks import EstimateTask, Job
from .variants import JOIN

TABLE = "ablation.parquet"
_DIGEST = b"sfmkit.sha256"

_text, _count, _number = pa.string(), pa.int64(), pa.float64()
SCHEMA = pa.schema(
    [
        ("dataset", _text),
        ("sequence", _text),
        ("pair", _text),
        ("kind", _text),
        ("has_truth", pa.bool_()),
        ("combination", _text),
        ("operators", pa.list_(_text)),
        ("n_operators", _count),
        ("preset", _text),
        ("vary", _text),
        ("seed", _count),
        ("keypoints1", _count),
        ("keypoints2", _count),
        ("matches", _count),
        ("correspondences", _count),
        ("inliers", _count),
        ("guided", _count),
        ("error", _number),
        ("error_unit", _text),
        ("corner_error_px", _number),
        ("check_error_px", _number),
        ("rmse", _number),
        ("rotation_deg", _number),
        ("translation_deg", _number),
        ("status", _text),
        ("verdict", _text),
        ("reason", _text),
        ("failure", _text),
        ("H", pa.list_(_number)),
        ("R", pa.list_(_number)),
        ("t", pa.list_(_number)),
        ("seconds_detect", _number),
        ("seconds_match", _number),
        ("seconds_fuse", _number),
        ("seconds_estimate", _number),
        ("seconds", _number),
        ("peak_memory_mb", _number),
        ("versions", _text),
        ("machine", _text),
    ]
)

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
    """The row of a job.

    Args:
        result: of the estimate, or the reason why there is none.
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
    """Errors against the truth; infinite where there is no estimate to compare.

    A homography is judged at its check points where there are some, else at the corners of image 1.
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
    if not np.any(pair.t):  # taken from one place: there is no direction to get wrong
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
        data: a pyarrow table with :data:`SCHEMA`.
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

    def results(self) -> pa.Table:
        """Without the columns in which two runs of one sweep differ."""
        return self.data.drop_columns(list(VOLATILE))

    def to_pandas(self):
        """A pandas DataFrame, where pandas is installed."""
        return self.data.to_pandas()


def table_of(rows: Sequence[Row]) -> pa.Table:
    return pa.Table.from_pylist(list(rows), schema=SCHEMA)


def write_table(data: pa.Table, path: Path) -> None:
    """Write a table as Parquet, with a digest of its values and a checksum of every page.

    Raises:
        OutputError: The file cannot be written.
    """
    sealed = data.replace_schema_metadata({_DIGEST: content_digest(data)})
    with atomic_write(path) as temporary:
        pq.write_table(sealed, temporary, compression="zstd", write_page_checksum=True)


def read_table(path: str | os.PathLike) -> AblationTable:
    """Read the table of a sweep: its Parquet file, or the folder that holds it.

    Raises:
        InputError: There is none, or it is damaged; see :func:`read_shard`.
    """
    file = Path(path)
    file = file / TABLE if file.is_dir() else file
    if not file.is_file():
        raise InputError(
            f"there is no {file}; `sfmkit ablate ... --out {Path(path)}` writes it, and completes "
            "an interrupted sweep"
        )
    return AblationTable(read_shard(file), file)


def read_shard(file: Path) -> pa.Table:
    """Read a Parquet file that :func:`write_table` wrote.

    Raises:
        InputError: The file cannot be read, has other columns or types, or its values differ from
            those that were written.
    """
    try:
        data = pq.read_table(
            pa.BufferReader(file.read_bytes()), page_checksum_verification=True, use_threads=False
        )
        metadata = data.schema.metadata or {}
        data = data.replace_schema_metadata(None)
        known = data.schema.equals(SCHEMA)
        intact = known and metadata.get(_DIGEST, b"").decode() == content_digest(data)
    except Exception as error:  # damaged bytes: whatever Arrow's readers and decoders raise
        raise InputError(f"{file} cannot be read as Parquet, or is damaged: {error}") from None
    if not known:
        raise InputError(
            f"{file} has other columns than the table of an ablation; it may be of another version"
        )
    if not intact:
        raise InputError(
            f"{file} is damaged: its values differ from those that were written. Remove it and run "
            "the sweep again; what is cached is used again"
        )
    return data


def content_digest(data: pa.Table) -> str:
    """Sha256 of the names and values of a table, independent of their layout in memory."""
    digest = hashlib.sha256()
    for name, column in zip(data.column_names, data.columns, strict=True):
        array = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
        digest.update(f"{name} {len(array)}\n".encode())
        for values in _flat(array):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _flat(array: pa.Array) -> Iterator[np.ndarray]:
    """The values of a column as arrays of numbers: validity, lengths, and values without nulls."""
    yield array.is_valid().to_numpy(zero_copy_only=False)
    present = array.drop_null()
    if pa.types.is_list(array.type):
        yield pc.list_value_length(present).to_numpy(zero_copy_only=False)
        yield from _flat(present.flatten())
    elif pa.types.is_string(array.type):
        yield pc.binary_length(present).to_numpy(zero_copy_only=False)
        yield np.frombuffer("".join(present.to_pylist()).encode(), np.uint8)
    else:
        yield present.to_numpy(zero_copy_only=False)
