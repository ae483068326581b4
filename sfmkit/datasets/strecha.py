"""The EPFL multi-view set (fountain-P11, Herz-Jesu-P8, ...): undistorted photographs with cameras
from laser scans.

Strecha, von Hansen, Van Gool, Fua & Thoennessen, "On benchmarking camera calibration and multi-view
stereo for high resolution imagery", CVPR 2008.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from PIL import Image

from ..errors import InputError
from ..io.cameras import parse_intrinsics, read_truth
from ..types import Camera
from .pair import Pair, choose_sequences, data_root, neighbours, photographs


def strecha(
    data: str | os.PathLike | None = None, sequences: Iterable[str] | None = None, step: int = 1
) -> Iterator[Pair]:
    """Each photograph with the one `step` further on, with cameras and pose.

    A sequence is a folder with ``images/`` and ``gt_dense_cameras/<image>.camera``.

    Raises:
        InputError: the data set, a sequence or a camera is missing or unreadable, or `step` is not
            positive.
    """
    if step < 1:
        raise InputError(f"step must be a whole number of at least 1, not {step}")
    root = data_root("strecha", data)
    present = sorted(f.name for f in root.iterdir() if (f / "images").is_dir())
    for sequence in choose_sequences(root, present, sequences):
        folder = root / sequence
        files = photographs(folder / "images")
        for k in range(step):
            for a, b in neighbours(files[k::step], folder / "images"):
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
    with Image.open(image) as picture:  # reads the header only
        return parse_intrinsics(file, picture.size)
