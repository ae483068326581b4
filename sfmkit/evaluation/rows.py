"""Rows of a benchmark in a file, so that an interrupted run can be resumed."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._utils.sharding import Shard
from ..datasets.pair import natural_order
from ..errors import InputError

Row = dict[str, Any]


def finite(value: float | None) -> float | None:
    """Return a finite number unchanged, and None otherwise: JSON has no NaN or infinity."""
    return value if value is not None and math.isfinite(value) else None


@dataclass(frozen=True)
class RowStore:
    """A file with one JSON object per line; the first line contains the settings of the run.

    A shard writes to a file of its own beside `path`, so several shards can run in one folder.

    Attributes:
        path: File of a run without shards, such as ``rows.jsonl``.
        settings: Settings on which the rows depend, as JSON values.
        shard: (i, n) for the file ``rows.i-of-n.jsonl``.
    """

    path: Path
    settings: dict[str, Any]
    shard: Shard | None = None

    @property
    def own(self) -> Path:
        """The file that this run writes."""
        if self.shard is None:
            return self.path
        number, of = self.shard
        return self.path.with_suffix(f".{number}-of-{of}{self.path.suffix}")

    def read(self) -> list[Row]:
        """Return the stored rows of this run and of all shards; create the file if it is missing.

        An incomplete last line, from an interrupted run, is removed from the own file and ignored
        in the others, whose runs may still write.

        Raises:
            InputError: A file was made with other settings or is damaged.
        """
        if not self.own.exists():
            self.own.parent.mkdir(parents=True, exist_ok=True)
            self.own.write_text(json.dumps({"settings": self.settings}) + "\n", encoding="utf-8")
        data = self.own.read_bytes()
        if not data.endswith(b"\n") and b"\n" in data:
            self.own.write_bytes(data[: data.rfind(b"\n") + 1])
        shards = self.path.parent.glob(f"{self.path.stem}.*-of-*{self.path.suffix}")
        files = {self.path, self.own, *shards}
        rows: list[Row] = []
        for file in sorted(filter(Path.exists, files), key=lambda file: natural_order(file.name)):
            settings, found = read_rows(file)
            if settings != self.settings:
                raise InputError(
                    f"{file} was made with {settings}, not {self.settings}; choose another --out, "
                    "or remove the file to start again"
                )
            rows += found
        return rows

    def append(self, rows: list[Row]) -> None:
        """Append all rows of a part in one write, so that a crash leaves complete parts only."""
        with self.own.open("a", encoding="utf-8") as file:
            file.write("".join(json.dumps(row) + "\n" for row in rows))


def read_rows(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Read the settings and the complete rows of a file that :class:`RowStore` wrote.

    Raises:
        InputError: The file cannot be read, or a line is not a JSON object.
    """
    try:
        data = path.read_bytes()
        lines = data[: data.rfind(b"\n") + 1].decode("utf-8").splitlines()
        values = [json.loads(line) for line in lines]
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} is damaged ({error}); remove it to start again") from None
    for number, value in enumerate(values, start=1):
        if not isinstance(value, dict):
            raise InputError(f"{path}, line {number} is not a row; remove the file to start again")
    if not values or not isinstance(values[0].get("settings"), dict):
        raise InputError(f"{path} does not start with its settings; remove it to start again")
    return values[0]["settings"], values[1:]
