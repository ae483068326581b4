"""The folder of a sweep.

It holds::

    sweep.json          operators, combinations, pairs with their truth, versions; with a digest
    images/             images that were given as arrays
    shards/KEY.parquet  rows of one unit of work; the key identifies it, so it cannot be there twice
    ablation.parquet    all rows, in the order of the plan
"""

from __future__ import annotations

import json
import os
import shutil
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pyarrow as pa

from .._utils.writing import atomic_write, check_folder
from ..errors import InputError, OutputError
from .lock import locked
from .plan import Plan
from .table import TABLE, AblationTable, table_of
from .table_file import read_shard, write_table
from .tasks import EstimateTask
from .version import digest

_SWEEP = "sweep.json"


class SweepFolder:
    """The folder at a path, which is created with its parents if it does not exist."""

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        check_folder(self.path)
        try:
            self.shards.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be written: {error.strerror or error}"
            ) from error

    @property
    def shards(self) -> Path:
        return self.path / "shards"

    @property
    def images(self) -> Path:
        return self.path / "images"

    def locked(self) -> AbstractContextManager[None]:
        """Keep the folder to this process, see :func:`sfmkit.ablation.lock.locked`."""
        return locked(self.path)

    def open(self, plan: Plan) -> None:
        """Write the description of a plan to the folder, or compare it with the stored one.

        Raises:
            InputError: It holds another sweep, or its ``sweep.json`` is damaged.
        """
        file = self.path / _SWEEP
        if file.is_file():
            found = read_sweep(self.path)
            if found["identity"] != plan.identity:
                raise InputError(
                    f"{self.path} holds another sweep: {_difference(found, plan.as_json())}. "
                    "Choose "
                    "another --out, or remove the folder; what is cached is used again either way"
                )
        else:
            write_sweep(self.path, plan.as_json())
        for leftover in self.shards.glob(".*"):  # of a process that was killed
            leftover.unlink()

    def has(self, unit: EstimateTask) -> bool:
        return self._shard(unit).is_file()

    def write(self, unit: EstimateTask, rows: list[dict[str, Any]]) -> None:
        """Add the shard of a unit in one step."""
        write_table(table_of(rows), self._shard(unit))

    def merge(self, plan: Plan) -> AblationTable:
        """Write all shards as one table, in the order of the plan, and return it."""
        data = pa.concat_tables(
            [read_shard(self._shard(unit)) for unit in plan.units]
        ).combine_chunks()
        write_table(data, self.path / TABLE)
        return AblationTable(data, self.path / TABLE)

    def _shard(self, unit: EstimateTask) -> Path:
        return self.shards / f"{unit.key}.parquet"

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)


def write_sweep(path: str | os.PathLike, content: dict[str, Any]) -> None:
    """Write ``sweep.json`` into a folder, with a digest of its content.

    Raises:
        OutputError: The file cannot be written.
    """
    with atomic_write(Path(path) / _SWEEP) as temporary:
        text = json.dumps(content | {"digest": digest(content)}, indent=1)
        temporary.write_text(text, encoding="utf-8")


def read_sweep(path: str | os.PathLike) -> dict[str, Any]:
    """Read the description of the sweep in a folder from ``sweep.json``.

    Returns:
        Operators, combinations, variants, seeds, and the pairs with their truth.

    Raises:
        InputError: There is no sweep, or the file is damaged.
    """
    file = Path(path) / _SWEEP
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} holds no sweep; `sfmkit ablate` makes one") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(_damaged(file, str(error))) from None
    stored = found.pop("digest", None) if isinstance(found, dict) else None
    if stored is None:
        raise InputError(_damaged(file, "it has no digest"))
    if stored != digest(found):
        raise InputError(_damaged(file, "its digest differs"))
    return found


def _damaged(file: Path, why: str) -> str:
    return (
        f"{file} is damaged or of another version ({why}); choose another --out, or remove "
        f"{file.parent}; what is cached is used again"
    )


def _difference(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The first difference of two sweeps as text."""
    for name in ("operators", "combinations", "variants", "seeds"):
        if found.get(name) != wanted[name]:
            return f"its {name} differ"
    if [p["pair"] for p in found["pairs"]] != [p["pair"] for p in wanted["pairs"]]:
        return f"it has {len(found['pairs'])} pairs, not these {len(wanted['pairs'])}"
    if found.get("engine") != wanted["engine"]:
        return f"it was made by {found.get('engine')}, here is {wanted['engine']}"
    return "its images, cameras or plug-ins have changed"
