"""Rows of measurements that outlive an interruption."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from ..errors import InputError

Row = dict[str, Any]


def finite(value: float | None) -> float | None:
    """The number, or None for what JSON cannot hold."""
    return value if value is not None and math.isfinite(value) else None


class RowStore:
    """Rows on disk, one JSON object a line; the first line holds the settings that they were made
    with."""

    def __init__(self, path: Path, settings: dict[str, Any]):
        self.path, self.settings = path, settings

    def read(self) -> list[Row]:
        """The rows so far; an incomplete last line, from an interrupted run, is cut off.

        Raises:
            InputError: the file was made with other settings, or is no such file.
        """
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_text(json.dumps({"settings": self.settings}) + "\n")
            return []
        text = self.path.read_text()
        if not text.endswith("\n"):
            text = text[: text.rfind("\n") + 1]
            self.path.write_text(text)
        try:
            first, *rows = [json.loads(line) for line in text.splitlines()] or [{}]
        except json.JSONDecodeError as error:
            raise InputError(
                f"{self.path} is damaged ({error}); remove it to begin again"
            ) from None
        if first.get("settings") != self.settings:
            raise InputError(
                f"{self.path} was made with {first.get('settings')}, not {self.settings}; choose another --out, or "
                "remove it to begin again"
            )
        return rows

    def append(self, rows: list[Row]) -> None:
        """All rows of a part in one write: a part is there whole or, after a crash, not counted."""
        with self.path.open("a") as file:
            file.write("".join(json.dumps(row) + "\n" for row in rows))
