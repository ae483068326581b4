"""The Middlebury temple ring: 16 photographs around a plaster model, in the order of the ring.

Seitz, Curless, Diebel, Scharstein & Szeliski, "A comparison and evaluation of multi-view stereo
reconstruction algorithms", CVPR 2006.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..types import Camera
from .pair import data_root, image_size

__all__ = ["RingView", "temple_places", "temple_ring"]

_FOLDER, _CAMERAS = "templeSparseRing", "templeSR_par.txt"


@dataclass(frozen=True, eq=False)
class RingView:
    """A photograph of the ring.

    Attributes:
        path: The image.
        camera: Its intrinsics.
        R, t: (3, 3) and (3,) with ``x_cam = R X + t``.
    """

    path: Path
    camera: Camera
    R: np.ndarray
    t: np.ndarray


def temple_ring(root: str | os.PathLike | None = None) -> tuple[RingView, ...]:
    """Read the photographs with their cameras, ordered by their position on the ring.

    The file numbers have another order. Most neighbours are 23 degrees apart. Some cameras are
    upside down, and two photographs were taken from the same position.

    Args:
        root: See :func:`sfmkit.datasets.pair.data_root`; the photographs lie in
            ``middlebury/templeSparseRing``.

    Raises:
        InputError: The data set is missing or its camera file is damaged.
    """
    folder = data_root("middlebury", root) / _FOLDER
    file = folder / _CAMERAS
    try:
        rows = [line.split() for line in file.read_text().splitlines()[1:] if line.strip()]
        numbers = np.array([row[1:] for row in rows], dtype=np.float64).reshape(len(rows), 21)
    except (OSError, ValueError) as error:
        raise InputError(f"{file} is missing or damaged: {error}") from None
    K, R, t = numbers[:, :9].reshape(-1, 3, 3), numbers[:, 9:18].reshape(-1, 3, 3), numbers[:, 18:]
    centres = -np.einsum("nji,nj->ni", R, t)
    centres -= centres.mean(0)
    x, y = np.linalg.svd(centres)[2][:2] @ centres.T
    views = []
    for i in np.argsort(np.arctan2(y, x)):
        path = folder / rows[i][0]
        views.append(RingView(path, Camera(K[i], image_size(path)), R[i], t[i]))
    return tuple(views)


def temple_places(root: str | os.PathLike | None = None) -> tuple[RingView, ...]:
    """Read the ring without the second of two photographs from one position.

    Arguments and errors are those of :func:`temple_ring`.
    """
    ring = temple_ring(root)
    return tuple(
        view for view, before in zip(ring, (ring[-1], *ring)) if not np.allclose(view.t, before.t)
    )
