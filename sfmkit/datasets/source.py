"""The values of ``--data``: data sets, import paths, pair lists and folders."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..errors import InputError
from .colmap import colmap, model_folder
from .pair import Pair
from .pair_list import pair_list
from .pairs_with_gt import pairs_with_gt
from .photographs import photographs
from .registry import DATASETS, DatasetReader

LIST_READERS = {".json": pair_list, ".csv": pair_list, ".txt": pairs_with_gt}


@dataclass(frozen=True)
class Source:
    """A data set that was found.

    Attributes:
        text: The text by which it was found.
        reader: Function that yields its pairs.
        root: Folder or file for the reader; None if the user gave none.
        sequences: Chosen sequences; None for all.
        name: Name in :data:`DATASETS`; None for a list or a folder.
    """

    text: str
    reader: DatasetReader
    root: str | os.PathLike | None
    sequences: tuple[str, ...] | None
    name: str | None = None

    def pairs(self, sequences: tuple[str, ...] | None = None) -> list[Pair]:
        """Read all pairs of the chosen sequences.

        Raises:
            InputError: The data set is missing or damaged, or a plug-in yields something other than
                a pair.
        """
        found = list(self.reader(self.root, sequences=sequences or self.sequences))
        for pair in found:
            if not isinstance(pair, Pair):
                raise InputError(
                    f"data set '{self.text}' yields a {type(pair).__name__}, not a Pair"
                )
        return found


def find_source(data: str | os.PathLike, root: str | os.PathLike | None = None) -> Source:
    """Find a data set by name, path or import path.

    The text is, in this order: a registered name or entry point; the path of a pair list
    (``.json``, ``.csv``, ``*_pairs_with_gt.txt``), of a COLMAP model or of a folder of photographs;
    an import path ``package.module:name``. Each may be followed by ``:SEQUENCE+SEQUENCE``.

    Args:
        data: The text.
        root: Folder of the data sets; for a list or a COLMAP model, the folder of its images.

    Raises:
        InputError: There is no such data set or file.
    """
    text = os.fspath(data).strip()
    head, _, tail = text.partition(":")
    if head in DATASETS:
        return Source(text, DATASETS[head], root, _sequences(tail), head)
    path, tail = (text, "") if Path(text).exists() else _last_colon(text)
    if Path(path).exists():
        return Source(text, _path_reader(Path(path), root), path, _sequences(tail))
    if os.sep in text or Path(text).suffix in LIST_READERS:
        raise InputError(f"there is no file or folder {path}")
    module, colon, rest = text.partition(":")
    attribute, _, tail = rest.partition(":")
    name = f"{module}{colon}{attribute}"
    return Source(text, DATASETS[name], root, _sequences(tail), name)


def _path_reader(path: Path, root: str | os.PathLike | None) -> DatasetReader:
    """Choose the reader of a list or a folder."""
    if path.is_file():
        if path.suffix.lower() not in LIST_READERS:
            raise InputError(
                f"{path} is not a pair list; pair lists end in {', '.join(LIST_READERS)}"
            )
        return partial(LIST_READERS[path.suffix.lower()], images=root)
    if model_folder(path) is not None:
        return partial(colmap, images=root)
    return photographs


def _last_colon(text: str) -> tuple[str, str]:
    path, colon, tail = text.rpartition(":")
    return (path, tail) if colon else (text, "")


def _sequences(text: str) -> tuple[str, ...] | None:
    return tuple(name for name in text.split("+") if name) or None
