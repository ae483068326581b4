"""Folders of photographs from a drone: pairs along the flight, cameras from EXIF, no truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from ..errors import InputError
from .pair import Pair, choose_sequences, data_root, photographs


def uav(
    data: str | os.PathLike | None = None, sequences: Iterable[str] | None = None, step: int = 1
) -> Iterator[Pair]:
    """Each photograph of a flight with the one `step` further on. The cameras are left to EXIF.

    A sequence is a folder of photographs below ``uav/``.

    Raises:
        InputError: the data set or a sequence is missing, or holds too few photographs for a pair;
            `step` is not positive.
    """
    if step < 1:
        raise InputError(f"step must be a whole number of at least 1, not {step}")
    root = data_root("uav", data)
    present = sorted(f.name for f in root.iterdir() if f.is_dir())
    for sequence in choose_sequences(root, present, sequences):
        files = photographs(root / sequence)
        if len(files) <= step:
            raise InputError(
                f"{root / sequence} holds {len(files)} photographs; pairs {step} apart take {step + 1}"
            )
        for a, b in zip(files, files[step:]):
            yield Pair("uav", sequence, f"{a.stem}-{b.stem}", a, b)
