"""Files of hloc: ``features.h5``, ``matches.h5`` and ``pairs.txt``.

In hloc (https://github.com/cvg/Hierarchical-Localization) the centre of the top-left pixel is
(0, 0), as in sfmkit. hloc adds the half pixel of COLMAP itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .._utils.hdf5 import h5py_module
from .._utils.writing import staged_folder
from ..ablation.entry import Entry
from ..errors import InputError
from .collection import Collection
from .keypoint_lists import KeypointList, RowMatches, match_rows
from .matched_folder import MatchedFolder

__all__ = ["check_names", "write_hloc"]


def check_names(collection: Collection) -> None:
    """Raise InputError if ``pairs.txt`` cannot contain the name of a photograph."""
    spaced = next((name for name in collection.names if name.split() != [name]), None)
    if spaced is not None:
        raise InputError(f"the pairs.txt of hloc cannot hold names with spaces: '{spaced}'")


def write_hloc(
    matched: MatchedFolder,
    lists: Mapping[int, KeypointList],
    folder: Path,
    *,
    overwrite: bool = False,
) -> None:
    """Write a matched folder in the layout of hloc, whole or not at all.

    ``features.h5`` has a group per image with ``keypoints`` (N, 2) and ``image_size``, and, beyond
    hloc's layout, the provenance ``sfmkit_row``, ``sfmkit_operator`` and ``sfmkit_index``.
    ``matches.h5`` has a group per pair, ``NAME1/NAME2`` with ``/`` in the names replaced by ``-``,
    with ``matches0`` (N1,), the row in the second image or -1, and ``matching_scores0``, 1 - ratio.
    Only the best match of a keypoint is written, because the layout permits only one. The matches
    are those before geometric verification, because hloc repeats it.

    Raises:
        InputError: h5py is not installed, or a name has a space.
        OutputError: The folder exists and `overwrite` is not set, or cannot be written.
    """
    h5py = h5py_module()
    names = matched.plan.collection.names
    check_names(matched.plan.collection)
    with staged_folder(folder, overwrite) as staged:
        with h5py.File(staged / "features.h5", "w") as file:
            file.attrs["sfmkit_operators"] = list(matched.plan.recipe.operators)
            for index, found in lists.items():
                group = file.create_group(names[index])
                group.create_dataset("keypoints", data=found.xy)
                group.create_dataset("image_size", data=np.array(found.size_wh))
                group.create_dataset("sfmkit_row", data=found.row)
                group.create_dataset("sfmkit_operator", data=found.operator)
                group.create_dataset("sfmkit_index", data=found.index)
        lines = []
        with h5py.File(staged / "matches.h5", "w") as file:
            for row, (i, j) in enumerate(matched.plan.pairs.tolist()):
                entry = matched.geometry(row)
                if not isinstance(entry, Entry):
                    continue
                lines.append(f"{names[i]} {names[j]}")
                group = file.create_group(
                    "/".join(n.replace("/", "-") for n in (names[i], names[j]))
                )
                best, score = _one_each(match_rows(entry, lists[i], lists[j]), len(lists[i].xy))
                group.create_dataset("matches0", data=best)
                group.create_dataset("matching_scores0", data=score)
        (staged / "pairs.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _one_each(found: RowMatches, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) int32 best match of every keypoint, -1 for none, and (n,) float16 scores."""
    best, score = np.full(n, -1, np.int32), np.zeros(n, np.float16)
    ratio = np.where(np.isfinite(found.ratio), found.ratio, 0.0)
    order = np.argsort(-ratio, kind="stable")  # the best match is written last
    i, j = found.rows[order].T
    best[i], score[i] = j, (1 - ratio[order]).clip(0, 1)
    return best, score
