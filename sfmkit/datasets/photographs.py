"""A folder of photographs: pairs in the order of the file names, without ground truth."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import TypeVar

from ..errors import InputError
from .pair import Pair, image_files

CONSECUTIVE, ALL = "consecutive", "all"

T = TypeVar("T")


def photographs(root: str | os.PathLike, sequences: Iterable[str] | None = None) -> Iterator[Pair]:
    """Yield the pairs of a folder of photographs.

    Args:
        root: The folder.
        sequences: ``consecutive`` (the default: each photograph with the next one, in the order of
            the numbers in their names) or ``all`` (all pairs).

    Raises:
        InputError: The folder is missing or holds fewer than two photographs, or the sequence is
            unknown.
    """
    folder = Path(root)
    for sequence, a, b in choose_pairs(image_files(folder), sequences, str(folder)):
        yield Pair(folder.resolve().name, sequence, f"{a.stem}-{b.stem}", a, b)


def choose_pairs(
    items: Sequence[T], sequences: Iterable[str] | None, where: str
) -> Iterator[tuple[str, T, T]]:
    """Yield sequence, first and second item of every pair of a folder or model.

    Raises:
        InputError: There are fewer than two items, or the sequence is unknown.
    """
    for sequence in (CONSECUTIVE,) if sequences is None else sequences:
        if sequence not in (CONSECUTIVE, ALL):
            raise InputError(
                f"{where}: the pairs can be '{CONSECUTIVE}' or '{ALL}', not '{sequence}'"
            )
        if len(items) < 2:
            raise InputError(f"{where} holds {len(items)} photographs; a pair takes two")
        for a, b in pairwise(items) if sequence == CONSECUTIVE else combinations(items, 2):
            yield sequence, a, b
