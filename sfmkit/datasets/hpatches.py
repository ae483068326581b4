"""The full image sequences of HPatches, each with six images and five homographies.

The viewpoint changes in folders ``v_*``, the illumination in folders ``i_*``.

Balntas, Lenc, Vedaldi & Mikolajczyk, "HPatches: a benchmark and evaluation of handcrafted and
learned local descriptors", CVPR 2017.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..errors import InputError
from .pair import Pair, choose_sequences, data_root, find_image, read_homography


def hpatches(
    root: str | os.PathLike | None = None, sequences: Iterable[str] | None = None
) -> Iterator[Pair]:
    """Yield the pairs 1-2 ... 1-6 of each sequence, with H.

    Arguments and errors are the same as for :func:`~sfmkit.datasets.oxford.oxford`.
    """
    home = data_root("hpatches", root)
    for sequence in choose_sequences(home, _present(home), sequences):
        folder = home / sequence
        first = find_image(folder, "1")
        for k in range(2, 7):
            H = read_homography(folder / f"H_1_{k}")
            yield Pair("hpatches", sequence, f"1-{k}", first, find_image(folder, f"{k}"), H=H)


def sequences_of_hpatches(
    root: str | os.PathLike | None = None,
    sequences: Iterable[str] | None = None,
    without: Iterable[str] | None = None,
) -> tuple[str, ...]:
    """Choose sequences of HPatches.

    Args:
        root: See :func:`hpatches`.
        sequences: Names; None for all that are present.
        without: Names that are left out.

    Raises:
        InputError: The data set or a named sequence is missing, or none is left.
    """
    home = data_root("hpatches", root)
    present = _present(home)
    omitted = choose_sequences(home, present, without or ()) if without else ()
    chosen = choose_sequences(home, present, sequences)
    left = tuple(name for name in chosen if name not in omitted)
    if not left:
        raise InputError("no sequence is left")
    return left


def _present(home: Path) -> list[str]:
    return sorted(f.name for f in home.iterdir() if f.is_dir() and f.name[:2] in ("v_", "i_"))
