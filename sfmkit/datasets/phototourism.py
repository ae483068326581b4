"""The validation scenes of the Image Matching Challenge (PhotoTourism), with cameras and poses.

A scene is a folder ``SCENE/set_100`` with ``images/NAME.jpg``, ``calibration/calibration_NAME.h5``
(K, R and T with ``X_cam = R X + T``) and ``new-vis-pairs/keys-th-0.1.npy``, the names of the pairs
whose images share at least a tenth of the scene, as ``NAME1-NAME2``.

Jin, Mishkin, Mishchuk, Matas, Fua, Yi & Trulls, "Image matching across wide baselines: from paper
to practice", IJCV 2021.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from .._utils.hdf5 import h5py_module
from ..errors import InputError
from ..types import Camera
from .pair import Pair, choose_sequences, data_root, find_image, image_size

__all__ = ["phototourism"]

_SET = "set_100"


def phototourism(
    root: str | os.PathLike | None = None,
    sequences: Iterable[str] | None = None,
    *,
    covisibility: float = 0.1,
) -> Iterator[Pair]:
    """Yield the pairs of each scene, with cameras and poses.

    K is used as it is stored, as in the evaluation of the challenge.

    Args:
        root: Folder that contains ``phototourism/``, or that folder itself; None for
            ``SFMKIT_DATA`` or the folder of downloads.
        sequences: Names of scenes; None for all.
        covisibility: Lists of pairs exist for 0.0, 0.1 ... 0.9; 0.1 is that of the challenge.

    Raises:
        InputError: The data set, a scene or a file of it is missing or damaged, or h5py is not
            installed.
    """
    home = data_root("phototourism", root)
    present = sorted(f.name for f in home.iterdir() if (f / _SET).is_dir())
    for scene in choose_sequences(home, present, sequences):
        folder = home / scene / _SET
        for name in _names(folder / "new-vis-pairs" / f"keys-th-{covisibility:.1f}.npy"):
            one, dash, two = name.partition("-")
            if not dash:
                raise InputError(f"{folder}: '{name}' is not a pair of names NAME1-NAME2")
            image1, image2 = (find_image(folder / "images", each) for each in (one, two))
            (camera1, R1, t1), (camera2, R2, t2) = (
                _calibration(folder / "calibration" / f"calibration_{each}.h5", image)
                for each, image in zip((one, two), (image1, image2))
            )
            R = R2 @ R1.T
            t = t2 - R @ t1
            yield Pair("phototourism", scene, name, image1, image2, camera1, camera2, R=R, t=t)


def _names(path: Path) -> list[str]:
    """Read a list of pairs; arrays that would have to be unpickled are refused."""
    try:
        names = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"there is no list of pairs {path}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a NumPy file of names: {error}") from None
    if names.ndim != 1 or names.dtype.kind != "U":
        raise InputError(f"{path} holds an array of {names.dtype}, not a list of names")
    return names.tolist()


def _calibration(path: Path, image: Path) -> tuple[Camera, np.ndarray, np.ndarray]:
    """Read camera, R (3, 3) and t (3,) of a photograph."""
    try:
        with h5py_module().File(path, "r") as file:
            K, R, t = (np.array(file[key], dtype=np.float64) for key in ("K", "R", "T"))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path} is not a calibration with K, R and T: {error}") from None
    if K.shape != (3, 3) or R.shape != (3, 3) or t.size != 3:
        raise InputError(f"{path}: K, R and T have the shapes {K.shape}, {R.shape} and {t.shape}")
    return Camera(K, image_size(image)), R, t.ravel()
