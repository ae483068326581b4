"""Data sets as iterators of typed pairs: ``for pair in pairs("oxford"): ...``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from ..errors import InputError
from .pair import Pair

__all__ = ["Pair", "pairs"]


def pairs(dataset: str, data: str | os.PathLike | None = None, **options: Any) -> Iterator[Pair]:
    """The pairs of a data set.

    Args:
        dataset: ``oxford``, ``hpatches``, ``strecha``, ``uav``, ``synthetic`` or ``planes``. For
            ``colmap`` and ``pair`` call :func:`sfmkit.datasets.colmap.colmap` and make a
            :class:`Pair`: they take files.
        data: folder that holds the data set; None: the environment variable ``SFMKIT_DATA``, or
            what was fetched.
        options: of the iterator, such as ``sequences``.

    Raises:
        InputError: unknown, missing or incomplete data set.
    """
    if dataset == "synthetic":
        from .synthetic_pairs import synthetic

        return synthetic(**options)
    if dataset == "planes":
        from .planes import planes

        return planes(**options)
    if dataset not in ("oxford", "hpatches", "strecha", "uav"):
        raise InputError(
            f"unknown data set '{dataset}'; there are oxford, hpatches, strecha, uav, synthetic and planes"
        )
    return getattr(import_module(f".{dataset}", __name__), dataset)(data, **options)
