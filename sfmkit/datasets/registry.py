"""The extension point of data sets: contract and registry."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from .._utils.registry import Registry
from .pair import Pair


class DatasetReader(Protocol):
    """A function that yields the pairs of a data set.

    A reader may have further keyword arguments with defaults. A reader whose pairs depend only on
    its code (rendered images) has an attribute ``generated`` with the names of its sequences. A
    sweep stores such pairs in its cache and renders each sequence once.
    """

    def __call__(self, root: Any, sequences: Iterable[str] | None = None) -> Iterable[Pair]:
        """Yield the pairs of a data set.

        Args:
            root: Path of the folder of the data sets; None if the user gave none.
            sequences: Names of the sequences to read; None for all of them.

        Raises:
            InputError: The data set or a sequence is missing or damaged.
        """
        ...


DATASETS: Registry[DatasetReader] = Registry("data set", "sfmkit.datasets")


def register_dataset(name: str, reader: DatasetReader) -> DatasetReader:
    """Register a data set under a name, for this process and its sweeps.

    Args:
        name: Name for ``--data`` and :func:`sfmkit.datasets.pairs`.
        reader: Function that fulfils the contract of :class:`DatasetReader`.

    Returns:
        `reader`.

    Raises:
        InputError: The name is malformed or taken by another reader, or `reader` is not callable.
    """
    return DATASETS.register(name, reader)
