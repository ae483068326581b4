"""Folders of photographs from a drone: consecutive pairs, cameras from EXIF, no truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from .pairs import Pair, choose_sequences, data_root, neighbours, photographs


def uav(data: str | os.PathLike | None = None, sequences: Iterable[str] | None = None) -> Iterator[Pair]:
    """Each photograph of a flight with the next one. The cameras are left to EXIF.

    A sequence is a folder of photographs below ``uav/``.

    Raises:
        InputError: the data set or a sequence is missing, or holds fewer than two photographs.
    """
    root = data_root("uav", data)
    present = sorted(f.name for f in root.iterdir() if f.is_dir())
    for sequence in choose_sequences(root, present, sequences):
        for a, b in neighbours(photographs(root / sequence), root / sequence):
            yield Pair("uav", sequence, f"{a.stem}-{b.stem}", a, b)
