"""The Parquet file of a table of an ablation: written in row groups, sealed by a digest."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .._utils.writing import atomic_write
from ..errors import InputError

__all__ = ["SCHEMA", "content_digest", "read_shard", "write_table", "write_tables"]

_DIGEST = "sfmkit.content"

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


def write_table(data: pa.Table, path: Path) -> None:
    """Write a table, see :func:`write_tables`."""
    write_tables([data], path)


def write_tables(parts: Iterable[pa.Table], path: Path) -> int:
    """Write tables one after another into one file, whole or not at all.

    Each table becomes at least one row group, and only one of them is in memory. The file has a
    digest of all values and a checksum of every page.

    Args:
        parts: Tables with :data:`SCHEMA`.
        path: The file; an existing one is replaced.

    Returns:
        The number of rows.

    Raises:
        OutputError: The file cannot be written.
    """
    digest, rows = _ContentDigest(), 0
    with atomic_write(path) as temporary:
        options = {"compression": "zstd", "write_page_checksum": True}
        with pq.ParquetWriter(temporary, SCHEMA, **options) as writer:
            for part in parts:
                bare = part.replace_schema_metadata(None)
                writer.write_table(bare)
                digest.update(bare)
                rows += part.num_rows
            writer.add_key_value_metadata({_DIGEST: digest.hexdigest()})
    return rows


def read_shard(file: Path) -> pa.Table:
    """Read a Parquet file that :func:`write_tables` wrote.

    Raises:
        InputError: The file cannot be read, has other columns or types, or its values differ from
            those that were written.
    """
    try:
        source = pa.BufferReader(file.read_bytes())
        with pq.ParquetFile(source, page_checksum_verification=True) as parquet:
            stored = (parquet.metadata.metadata or {}).get(_DIGEST.encode(), b"").decode()
            data = parquet.read(use_threads=False).replace_schema_metadata(None)
        known = data.schema.equals(SCHEMA)
        intact = known and stored == content_digest(data)
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
    """Sha256 of the names and values of a table, independent of its chunks and row groups."""
    digest = _ContentDigest()
    digest.update(data)
    return digest.hexdigest()


class _ContentDigest:
    """The digest of a table that arrives in parts."""

    def __init__(self) -> None:
        self._rows = 0
        self._parts: dict[tuple[str, int], hashlib._Hash] = {}

    def update(self, data: pa.Table) -> None:
        """Add rows."""
        self._rows += data.num_rows
        for name, column in zip(data.column_names, data.columns, strict=True):
            empty = pa.array([], column.type)
            array = pa.concat_arrays(column.chunks) if column.num_chunks else empty
            for k, values in enumerate(_flat(array)):
                part = self._parts.setdefault((name, k), hashlib.sha256())
                part.update(np.ascontiguousarray(values).tobytes())

    def hexdigest(self) -> str:
        """The digest of all rows."""
        whole = hashlib.sha256(f"{self._rows}\n".encode())
        for (name, k), part in self._parts.items():
            whole.update(f"{name} {k} {part.hexdigest()}\n".encode())
        return whole.hexdigest()


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
