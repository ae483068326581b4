"""File names as text that every output format can represent."""

from __future__ import annotations

import os

__all__ = ["label"]


def label(name: str) -> str:
    """Replace the characters of a file name that cannot be encoded in UTF-8.

    Such names come from old ZIP files, for example. The result is a label and may not be the name
    of an existing file.
    """
    return os.fsencode(name).decode(errors="replace")
