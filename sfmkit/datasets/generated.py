"""Data sets whose pairs are computed instead of read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Reader = TypeVar("Reader", bound=Callable)


def generated(sequences: Iterable[str]) -> Callable[[Reader], Reader]:
    """Declare that a data set's pairs depend on its code only, and name its sequences.

    A sweep stores such pairs in its cache, so each sequence is rendered once.
    """

    def mark(reader: Reader) -> Reader:
        reader.generated = tuple(sequences)  # type: ignore[attr-defined]
        return reader

    return mark
