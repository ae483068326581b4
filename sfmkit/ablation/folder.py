"""The folder of a sweep and the lock that keeps it to one process.

It holds::

    sweep.json          what the sweep is: operators, combinations, pairs with their truth, versions
    images/             images that came as arrays
    shards/KEY.parquet  rows of one unit of work; named by what they are, so none can be there twice
    ablation.parquet    all rows, in the order of the plan
"""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
from filelock import FileLock, Timeout

from .._utils.writing import atomic_write
from ..errors import InputError, OutputError
from .plan import Plan
from .table import TABLE, AblationTable, read_shard, table_of, write_table
from .tasks import EstimateTask

_SWEEP, _LOCK, _HOLDER = "sweep.json", ".lock", ".lock.json"


class SweepFolder:
    """Made, with its parents, where it does not exist."""

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file; choose a folder with --out")
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

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep the folder to this process.

        The system lets go of the lock when its holder ends, however it ends, so a lock that can be
        had is a free one; what the holder wrote beside it says who to wait for, and tells a machine
        of a shared file system, whose locks may not reach us, from this one.

        Raises:
            InputError: another sweep runs in this folder.
        """
        holder_file = self.path / _HOLDER
        lock = FileLock(self.path / _LOCK)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise InputError(self._busy(_read_holder(holder_file))) from None
        try:
            holder = _read_holder(holder_file)
            if holder and holder.get("host") != platform.node():
                raise InputError(
                    f"{self._busy(holder)} If that process is gone, remove {holder_file} and start again"
                )
            with atomic_write(holder_file) as file:
                file.write_text(json.dumps({"pid": os.getpid(), "host": platform.node()}))
            yield
            with suppress(OSError):
                holder_file.unlink()
        finally:
            lock.release()

    def _busy(self, holder: dict[str, Any] | None) -> str:
        who = f"process {holder['pid']} on {holder['host']}" if holder else "another process"
        return f"a sweep is running in {self.path} ({who}); wait for it, or choose another --out."

    def open(self, plan: Plan) -> None:
        """Make the folder this plan's, or check that it is.

        Raises:
            InputError: it holds another sweep.
        """
        file = self.path / _SWEEP
        if file.is_file():
            try:
                found = json.loads(file.read_text())
            except json.JSONDecodeError:
                raise InputError(
                    f"{file} is damaged; choose another --out (what is cached is used again)"
                ) from None
            if found.get("identity") != plan.identity:
                raise InputError(
                    f"{self.path} holds another sweep: {_difference(found, plan.as_json())}. Choose another --out, or remove "
                    "the folder; what is cached is used again either way"
                )
        else:
            with atomic_write(file) as temporary:
                temporary.write_text(json.dumps(plan.as_json(), indent=1))
        for leftover in self.shards.glob(
            ".*"
        ):  # of a process that was killed; nobody else writes here now
            leftover.unlink()

    def has(self, unit: EstimateTask) -> bool:
        return self._shard(unit).is_file()

    def write(self, unit: EstimateTask, rows: list[dict[str, Any]]) -> None:
        """Add the shard of a unit, whole or not at all."""
        write_table(table_of(rows), self._shard(unit))

    def merge(self, plan: Plan) -> AblationTable:
        """All shards as one table, in the order of the plan."""
        data = pa.concat_tables(
            [read_shard(self._shard(unit)) for unit in plan.units]
        ).combine_chunks()
        write_table(data, self.path / TABLE)
        return AblationTable(data, self.path / TABLE)

    def _shard(self, unit: EstimateTask) -> Path:
        return self.shards / f"{unit.key}.parquet"

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)


def read_sweep(path: str | os.PathLike) -> dict[str, Any]:
    """What the sweep in this folder is: operators, combinations, variants, seeds, and its pairs
    with their truth.

    Raises:
        InputError: there is none.
    """
    file = Path(path) / _SWEEP
    try:
        return json.loads(file.read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path} holds no sweep ({file.name}: {error}); `sfmkit ablate` makes one"
        ) from None


def _read_holder(file: Path) -> dict[str, Any] | None:
    try:
        holder = json.loads(file.read_text())
    except (OSError, json.JSONDecodeError):
        return None
    return holder if isinstance(holder, dict) and {"pid", "host"} <= holder.keys() else None


def _difference(found: dict[str, Any], asked: dict[str, Any]) -> str:
    """In what two sweeps differ, in words."""
    for name in ("operators", "combinations", "variants", "seeds"):
        if found.get(name) != asked[name]:
            return f"its {name} are not those asked for"
    if [p["pair"] for p in found.get("pairs", [])] != [p["pair"] for p in asked["pairs"]]:
        return f"it has {len(found.get('pairs', []))} pairs, not these {len(asked['pairs'])}"
    if found.get("engine") != asked["engine"]:
        return f"it was made by {found.get('engine')}, here is {asked['engine']}"
    return "its images or cameras have changed"
