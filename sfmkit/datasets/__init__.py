"""Data sets as iterables of typed pairs: ``for pair in pairs("oxford"): ...``."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from .hpatches import hpatches
from .oxford import oxford
from .pair import Pair
from .phototourism import phototourism
from .planes import planes
from .registry import DATASETS, DatasetReader, register_dataset
from .source import Source, find_source
from .strecha import strecha
from .synthetic_pairs import synthetic
from .uav import uav

__all__ = [
    "DATASETS",
    "DatasetReader",
    "Pair",
    "Source",
    "find_source",
    "pairs",
    "register_dataset",
]

for _reader in (oxford, hpatches, strecha, uav, phototourism, synthetic, planes):
    register_dataset(_reader.__name__, _reader)


def pairs(
    data: str | os.PathLike, root: str | os.PathLike | None = None, **options: Any
) -> Iterable[Pair]:
    """Yield the pairs of a data set, a pair list, a COLMAP model or a folder of photographs.

    Args:
        data: See :func:`sfmkit.datasets.find_source`: a name (``oxford``, ``oxford:graf+wall``), an
            import path (``mypackage.mine:pairs``), or the path of a list or folder.
        root: Folder that contains the data set; None for the environment variable ``SFMKIT_DATA``
            or the folder of downloads. For a list or a model, the folder of its images.
        options: Further arguments of the reader, such as ``sequences`` or ``step``.

    Raises:
        InputError: The data set is unknown, missing or incomplete.
    """
    source = find_source(data, root)
    return source.reader(source.root, **({"sequences": source.sequences} | options))
