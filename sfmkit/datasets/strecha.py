"""The EPFL multi-view set: fountain-P11, Herz-Jesu-P8 and others, with cameras from laser scans.

The photographs are undistorted.

Strecha, von Hansen, Van Gool, Fua & Thoennessen, "On benchmarking camera calibration and multi-view
stereo for high resolution imagery", CVPR 2008.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..errors import InputError
from ..io.intrinsics import parse_intrinsics
from ..io.truth import read_truth
from ..types import Camera
from .pair import Pair, choose_sequences, data_root, image_files, image_size


def strecha(
    root: str | os.PathLike | None = None, sequences: Iterable[str] | None = None, step: int = 1
) -> Iterator[Pair]:
    """Yield each photograph with the one `step` later, with cameras and pose.

    A sequence is a folder with ``images/`` and ``gt_dense_cameras/<image>.camera``.

    Args:
        root: Folder of the data sets, see :func:`sfmkit.datasets.pair.data_root`.
        sequences: Names of folders; None for all.
        step: Distance of the photographs of a pair in the sequence.

    Raises:
        InputError: The data set, a sequence or a camera is missing or unreadable, or `step` is not
            positive.
    """
    if step < 1:
        raise InputError(f"step must be a whole number of at least 1, not {step}")
    home = data_root("strecha", root)
    present = sorted(f.name for f in home.iterdir() if (f / "images").is_dir())
    for sequence in choose_sequences(home, present, sequences):
        folder = home / sequence
        files = image_files(folder / "images")
        if len(files) <= step:
            raise InputError(
                f"{folder / 'images'} holds {len(files)} photographs; "
                f"pairs {step} apart take {step + 1}"
            )
        for a, b in zip(files, files[step:]):
            one, two = (_truth_of(folder, image) for image in (a, b))
            R, t = read_truth(f"{one},{two}")
            yield Pair(
                "strecha",
                sequence,
                f"{a.stem}-{b.stem}",
                a,
                b,
                _camera(one, a),
                _camera(two, b),
                R=R,
                t=t,
            )


def _truth_of(folder: Path, image: Path) -> Path:
    file = folder / "gt_dense_cameras" / f"{image.name}.camera"
    if not file.is_file():
        raise InputError(f"the data set is incomplete: there is no {file}")
    return file


def _camera(file: Path, image: Path) -> Camera:
    return parse_intrinsics(file, image_size(image))
