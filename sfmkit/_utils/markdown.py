"""Rows of Markdown tables."""

from __future__ import annotations

import re
from collections.abc import Iterable

__all__ = ["escape", "table_row"]

_SPECIAL = re.compile(r"([\\`|*_\[\]<>&~$])")


def escape(text: str) -> str:
    """Escape a text for a cell of a table: no markup, no HTML, one line."""
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))


def table_row(cells: Iterable[str]) -> str:
    """Format a row of a table, with escaped cells."""
    return "| " + " | ".join(escape(cell) for cell in cells) + " |"
