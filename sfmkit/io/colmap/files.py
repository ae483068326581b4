"""Reading of COLMAP models, and writing of reconstructions as COLMAP models."""

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

    Binary files (``.bin``) are preferred to text files (``.txt``), as in COLMAP. Cameras with
    models that sfmkit does not support are read; :meth:`ColmapModel.camera` raises an error if an
    image needs one.

    Args:
        folder: Folder of the files.
        observations: Whether to read the observations and the cloud.

    Raises:
        InputError: A file is missing or damaged; the message contains the line or the byte.
    """
    folder = Path(folder)
    suffix = model_suffix(folder)
    if suffix is None:
        raise InputError(f"{folder} holds no COLMAP model (cameras and images as .txt or .bin)")
    return (read_binary if suffix == ".bin" else read_text)(folder, observations)


def model_suffix(folder: Path) -> str | None:
    """Return the suffix ``.bin`` or ``.txt`` of the model in a folder, or None."""
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

    The world is the frame of camera 1, in baselines. Every correspondence is an observation in both
    images, in the same order; the point id of correspondences without a point is -1. The camera
    models are PINHOLE, OPENCV with ``k1, k2, p1, p2``, FULL_OPENCV with more coefficients, or
    OPENCV_FISHEYE; two equal cameras are written once. Spaces in names are replaced by ``_``,
    because a space ends a name in the text format. Two images with the same name become ``1/name``
    and ``2/name``.

    Args:
        folder: Folder to write to.
        view: Geometry with a pose.
        corr: N correspondences.
        cloud: Points of the correspondences.
        names: Names of the two image files.
        binary: Whether to write ``.bin`` files instead of ``.txt``.

    Raises:
        InputError: The geometry has no translation, or COLMAP does not support a camera.
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
