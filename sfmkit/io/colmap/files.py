"""Read a COLMAP model, and write a reconstruction as one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from torch import Tensor

from ...errors import InputError
from ...types import Correspondences, PointCloud, TwoView
from .binary import read_binary, write_binary
from .cameras import ColmapCamera
from .model import NO_POINT, ColmapImage, ColmapModel, ColmapPoint
from .text import read_text, write_text


def read_colmap(folder: str | os.PathLike, *, observations: bool = True) -> ColmapModel:
    """Read a model: ``cameras``, ``images`` and, where present, ``points3D``.

    Binary files (``.bin``) are preferred to text (``.txt``), as COLMAP does. Cameras of models that
    this package does not have are read; :meth:`ColmapModel.camera` refuses them when an image
    needs one.

    Args:
        folder: that holds the files.
        observations: read the observed points and the cloud as well.

    Raises:
        InputError: missing or damaged files; the message has the line or the byte.
    """
    folder = Path(folder)
    suffix = model_suffix(folder)
    if suffix is None:
        raise InputError(f"{folder} holds no COLMAP model (cameras and images as .txt or .bin)")
    return (read_binary if suffix == ".bin" else read_text)(folder, observations)


def model_suffix(folder: Path) -> str | None:
    """``.bin`` or ``.txt`` of the model in a folder; None where there is none."""
    for suffix in (".bin", ".txt"):
        if all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images")):
            return suffix
    return None


def write_colmap(
    folder: str | os.PathLike,
    view: TwoView,
    corr: Correspondences,
    cloud: PointCloud,
    names: tuple[str, str],
    *,
    binary: bool = False,
) -> None:
    """Write a reconstruction as a COLMAP model into `folder`, which is created if missing.

    The world is the frame of camera 1 in baselines. Every correspondence is an observation in both
    images, in the same order; those without a point have the point id -1. Cameras are PINHOLE,
    OPENCV with ``k1, k2, p1, p2``, FULL_OPENCV with more, or OPENCV_FISHEYE; two equal ones become
    one. Spaces in names, which end a name there, become ``_``; two images of one name become
    ``1/name`` and ``2/name``.

    Args:
        names: of the two image files.
        binary: write ``.bin`` files instead of ``.txt``.

    Raises:
        InputError: the geometry has no pose, or a camera has what COLMAP's models lack.
    """
    model = _two_view_model(view, corr, cloud, names)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (write_binary if binary else write_text)(folder, model)


def _two_view_model(
    view: TwoView, corr: Correspondences, cloud: PointCloud, names: tuple[str, str]
) -> ColmapModel:
    if view.R is None or view.t is None:
        raise InputError(
            f"a COLMAP model needs a pose with a translation; the verdict is {view.verdict.value}"
        )
    cameras = [ColmapCamera.of(camera) for camera in (view.camera1, view.camera2)]
    ids = (1, 1 if cameras[0] == cameras[1] else 2)
    if names[0] == names[1]:
        names = (f"1/{names[0]}", f"2/{names[1]}")
    point_id = np.full(len(corr), NO_POINT, dtype=np.int64)
    point_id[_array(cloud.match)] = np.arange(1, len(cloud) + 1)
    poses = (np.eye(3), np.zeros(3)), (_array(view.R), _array(view.t))
    images = {
        k: ColmapImage("_".join(name.split()), camera_id, R, t, _array(x), point_id)
        for k, name, camera_id, x, (R, t) in zip((1, 2), names, ids, (corr.x1, corr.x2), poses)
    }
    points = {
        k: ColmapPoint(xyz, tuple(rgb), error, np.array([[1, row], [2, row]]))
        for k, xyz, rgb, error, row in zip(
            range(1, len(cloud) + 1),
            _array(cloud.xyz),
            cloud.rgb.tolist(),
            cloud.reprojection_error.tolist(),
            cloud.match.tolist(),
        )
    }
    return ColmapModel({k: cameras[k - 1] for k in sorted(set(ids))}, images, points)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()
