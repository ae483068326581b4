"""Names of files as text that every format can hold."""

from __future__ import annotations

import os

__all__ = ["label"]


def label(name: str) -> str:
    """Replace what cannot be encoded in UTF-8, as in a name that an old ZIP file brought along.

    For labels only: the result may not be the name of a file.
    """
    return os.fsencode(name).decode(errors="replace")
