"""The data sets that can be named: the extension point ``sfmkit.datasets``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from .._utils.registry import Registry
from .pair import Pair


class DatasetReader(Protocol):
    """A function that yields the pairs of a data set.

    A reader may have further keyword arguments with defaults. A reader whose pairs depend on
    nothing but its own code (rendered images) has an attribute ``generated``, the names of its
    sequences; a sweep then stores the pairs in its cache and renders each sequence once.
    """

    def __call__(self, root: Any, sequences: Iterable[str] | None = None) -> Iterable[Pair]:
        """The pairs of a data set.

        Args:
            root: The folder of the data sets (a path), or None where the user named none.
            sequences: The sequences to read; None for all of them.

        Raises:
            InputError: The data set or a sequence is missing or damaged.
        """
        ...


DATASETS: Registry[DatasetReader] = Registry("data set", "sfmkit.datasets")


def register_dataset(name: str, reader: DatasetReader) -> DatasetReader:
    """Register a data set under a name, for this process and its sweeps.

    Args:
        name: The name for ``--data`` and :func:`sfmkit.datasets.pairs`.
        reader: See :class:`DatasetReader`.

    Returns:
        `reader`.

    Raises:
        InputError: The name is malformed or taken by another reader, or `reader` is not callable.
    """
    return DATASETS.register(name, reader)
