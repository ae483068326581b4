"""``transforms.json`` for nerfstudio and Gaussian splatting."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..io.colmap.cameras import to_colmap
from ..recording.log_map import MapView

__all__ = ["make_transforms"]

_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward


def make_transforms(
    views: Sequence[MapView], files: Mapping[str, Path], folder: Path, cloud: str
) -> dict[str, Any]:
    """Convert cameras to the layout of nerfstudio.

    The world is that of the model and of `cloud`. Cameras look along -z with y up, as in OpenGL.
    The centre of the top-left pixel is (0.5, 0.5), as in COLMAP. Distortion coefficients other than
    ``k1 k2 p1 p2 k3`` are omitted, because the layout does not support them.

    Args:
        views: The registered photographs.
        files: Name -> path of a file with upright pixels.
        folder: Folder of ``transforms.json``; paths are relative to it.
        cloud: Name of the cloud in this folder.
    """
    frames = []
    for view in views:
        K, d, size = view.camera.K, view.camera.distortion, view.camera.size_wh
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = view.R.T, view.centre
        c = to_colmap(K[:2, 2])
        fisheye = view.camera.model == "fisheye"
        names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
        frames.append(
            {
                "file_path": os.path.relpath(files[view.name], folder),
                "camera_model": "OPENCV_FISHEYE" if fisheye else "OPENCV",
                "w": size[0],
                "h": size[1],
                "fl_x": float(K[0, 0]),
                "fl_y": float(K[1, 1]),
                "cx": float(c[0]),
                "cy": float(c[1]),
                **dict(zip(names, map(float, d))),
                "transform_matrix": (pose @ _TO_OPENGL).tolist(),
            }
        )
    model = frames[0]["camera_model"] if frames else "OPENCV"
    return {"camera_model": model, "ply_file_path": cloud, "frames": frames}
