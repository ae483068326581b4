"""Folders of drone photographs: pairs along the flight, without ground truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from ..errors import InputError
from .pair import Pair, choose_sequences, data_root, image_files


def uav(
    root: str | os.PathLike | None = None, sequences: Iterable[str] | None = None, step: int = 1
) -> Iterator[Pair]:
    """Yield each photograph of a flight with the one `step` later, without cameras.

    A sequence is a folder of photographs below ``uav/``.

    Args:
        root: Folder of the data sets, see :func:`sfmkit.datasets.pair.data_root`.
        sequences: Names of folders; None for all.
        step: Distance of the photographs of a pair in the flight.

    Raises:
        InputError: The data set or a sequence is missing, or holds too few photographs for a pair;
            or `step` is not positive.
    """
    if step < 1:
        raise InputError(f"step must be a whole number of at least 1, not {step}")
    home = data_root("uav", root)
    present = sorted(f.name for f in home.iterdir() if f.is_dir())
    for sequence in choose_sequences(home, present, sequences):
        files = image_files(home / sequence)
        if len(files) <= step:
            raise InputError(
                f"{home / sequence} holds {len(files)} photographs; "
                f"pairs {step} apart take {step + 1}"
            )
        for a, b in zip(files, files[step:]):
            yield Pair("uav", sequence, f"{a.stem}-{b.stem}", a, b)
