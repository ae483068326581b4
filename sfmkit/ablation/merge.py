"""The shards of a sweep as one sweep."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._utils.writing import check_free, staged_folder
from ..errors import InputError
from .folder import read_sweep, write_sweep
from .table import TABLE, check_table, read_table
from .table_file import write_tables
from .version import digest

__all__ = ["merge_shards"]

_EQUAL = ("operators", "combinations", "variants", "seeds", "plugins", "engine")


def merge_shards(
    shards: Sequence[str | os.PathLike],
    out: str | os.PathLike,
    *,
    overwrite: bool = False,
) -> int:
    """Merge the folders of all shards of a sweep into one folder.

    The rows are those of the sweep without shards, in its order. The folder can be reported on; it
    holds no units of work, so a sweep cannot be resumed in it. The rows of one shard at a time are
    in memory.

    Args:
        shards: The folders of ``sfmkit ablate --shard 1/N`` to ``N/N``, finished, in any order.
        out: The folder to write, whole or not at all.
        overwrite: Replace an existing folder.

    Returns:
        The number of rows.

    Raises:
        InputError: A shard is missing, unfinished, there twice, or of another sweep.
        OutputError: `out` exists and `overwrite` is not set, or cannot be written.
    """
    check_free(Path(out), overwrite)
    found = _in_order([(Path(path), read_sweep(path)) for path in shards])
    first = found[0][1]
    for path, other in found[1:]:
        different = [name for name in _EQUAL if other.get(name) != first.get(name)]
        if different:
            raise InputError(f"{path} and {found[0][0]} have different {', '.join(different)}")
    for path, _ in found:
        check_table(path)  # before the work
    sweep: dict[str, Any] = first | {
        "shard": None,
        "pairs": [pair for _, part in found for pair in part["pairs"]],
        "identity": digest("merged", [part["identity"] for _, part in found]),
    }
    with staged_folder(Path(out), overwrite) as staged:
        write_sweep(staged, sweep)
        return write_tables((read_table(path).data for path, _ in found), staged / TABLE)


def _in_order(shards: list[tuple[Path, dict[str, Any]]]) -> list[tuple[Path, dict[str, Any]]]:
    """The shards 1 to N, each once."""
    if not shards:
        raise InputError("name the folders of the shards")
    by_number: dict[int, tuple[Path, dict[str, Any]]] = {}
    for path, sweep in shards:
        if not sweep.get("shard"):
            raise InputError(f"{path} is not a shard; `sfmkit ablate --shard I/N` makes one")
        number, of = sweep["shard"]
        total = shards[0][1]["shard"][1]
        if of != total:
            raise InputError(f"{path} is one of {of} shards, {shards[0][0]} one of {total}")
        if number in by_number:
            raise InputError(f"{path} and {by_number[number][0]} are both shard {number} of {of}")
        by_number[number] = (path, sweep)
    missing = [k for k in range(1, total + 1) if k not in by_number]
    if missing:
        raise InputError(f"of {total} shards these are missing: {', '.join(map(str, missing))}")
    return [by_number[k] for k in sorted(by_number)]
