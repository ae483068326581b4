"""The result as a COLMAP text model: ``cameras.txt``, ``images.txt``, ``points3D.txt``.

COLMAP has the centre of the top-left pixel at (0.5, 0.5), we at (0, 0): principal points and
observations move by half a pixel on the way out.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from ..errors import InputError
from ..types import Camera, Correspondences, PointCloud, TwoView

HALF_PIXEL = 0.5


def write_colmap(
    folder: str | os.PathLike,
    view: TwoView,
    corr: Correspondences,
    cloud: PointCloud,
    names: tuple[str, str],
) -> None:
    """Write the model into `folder`, which is made if need be.

    The world is the frame of camera 1 in baselines. Every correspondence is an observation in both
    images, in the same order; those without a point have the point id -1. Cameras are PINHOLE,
    OPENCV with ``k1, k2, p1, p2``, or FULL_OPENCV with ``k3``; two equal ones become one. Spaces in
    names, which end a name there, become ``_``; two images of one name become ``1/name`` and
    ``2/name``.

    Args:
        names: of the two image files.

    Raises:
        InputError: the geometry has no pose, or a camera has skew, which COLMAP's models lack.
    """
    if view.R is None or view.t is None:
        raise InputError(
            f"a COLMAP model needs a pose with a translation; the verdict is {view.verdict.value}"
        )
    folder = Path(folder)
    cameras = [_camera(camera) for camera in (view.camera1, view.camera2)]
    ids = (1, 1 if cameras[0] == cameras[1] else 2)
    if names[0] == names[1]:
        names = (f"1/{names[0]}", f"2/{names[1]}")
    names = ("_".join(names[0].split()), "_".join(names[1].split()))
    point_id = np.full(len(corr), -1)
    point_id[_array(cloud.match)] = np.arange(1, len(cloud) + 1)
    poses = (np.eye(3), np.zeros(3)), (_array(view.R), _array(view.t))

    folder.mkdir(parents=True, exist_ok=True)
    _write(
        folder / "cameras.txt",
        "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
        (f"{k} {cameras[k - 1]}" for k in set(ids)),
    )
    images = (
        line
        for k, (name, x, (R, t)) in enumerate(zip(names, (corr.x1, corr.x2), poses))
        for line in (f"{k + 1} {_pose(R, t)} {ids[k]} {name}", _observations(_array(x), point_id))
    )
    _write(
        folder / "images.txt",
        "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME / POINTS2D[] as X Y POINT3D_ID",
        images,
    )
    points = (
        f"{k + 1} {x:.17g} {y:.17g} {z:.17g} {r} {g} {b} {error:.9g} 1 {row} 2 {row}"
        for k, ((x, y, z), (r, g, b), error, row) in enumerate(
            zip(
                cloud.xyz.tolist(),
                cloud.rgb.tolist(),
                cloud.reprojection_error.tolist(),
                cloud.match.tolist(),
            )
        )
    )
    _write(
        folder / "points3D.txt",
        "POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX",
        points,
    )


def _camera(camera: Camera) -> str:
    """``MODEL WIDTH HEIGHT PARAMS[]``."""
    if camera.K[0, 1]:
        raise InputError(f"COLMAP's camera models have no skew, and K[0, 1] is {camera.K[0, 1]:g}")
    k1, k2, p1, p2, k3 = camera.distortion
    values = [
        camera.K[0, 0],
        camera.K[1, 1],
        camera.K[0, 2] + HALF_PIXEL,
        camera.K[1, 2] + HALF_PIXEL,
    ]
    model = "PINHOLE"
    if camera.has_distortion:
        model, values = "OPENCV", [*values, k1, k2, p1, p2]
    if k3:
        model, values = "FULL_OPENCV", [*values, k3, 0, 0, 0]
    return f"{model} {camera.size_wh[0]} {camera.size_wh[1]} {_join(values)}"


def _pose(R: np.ndarray, t: np.ndarray) -> str:
    """``QW QX QY QZ TX TY TZ`` of ``X_camera = R X_world + t``."""
    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True)
    return _join([w, x, y, z, *t])


def _observations(x: np.ndarray, point_id: np.ndarray) -> str:
    return " ".join(
        f"{u:.17g} {v:.17g} {k}" for (u, v), k in zip((x + HALF_PIXEL).tolist(), point_id.tolist())
    )


def _join(values: Iterable[float]) -> str:
    return " ".join(f"{v:.17g}" for v in values)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()


def _write(path: Path, head: str, lines: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {head}\n")
        file.writelines(f"{line}\n" for line in lines)
