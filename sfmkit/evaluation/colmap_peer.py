"""COLMAP on the same photographs, through pycolmap (the extra ``peers``).

Features and matches go through COLMAP's database, which is much faster than its matcher in memory.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..io.colmap.cameras import to_colmap
from ..io.colmap.engine import pycolmap_module
from ..types import Camera, PointCloud

NAME = "colmap"
# Least angle between the rays of the first pair, degrees: COLMAP's default, then smaller ones. With
# two photographs there is only one pair to start from.
_TRIES_DEG, _PAIR_DEG = (16.0, 4.0, 1.5), (1.5,)


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """A sparse model computed by COLMAP.

    Attributes:
        cloud: Points in the frame of the first photograph, in units of its distance to the second
            one; None without a model that contains both.
        seconds: Durations of extraction, matching and mapping.
        images: Numbers of registered photographs and of all photographs.
    """

    cloud: PointCloud | None
    seconds: Mapping[str, float]
    images: tuple[int, int]

    @property
    def total_seconds(self) -> float:
        return sum(self.seconds.values())


def extract_and_match(
    database: Path, images: Sequence[Path], camera: Camera, **verification: Any
) -> dict[str, float]:
    """Write features and verified matches of photographs into a COLMAP database.

    All photographs are in one folder and were taken by one known camera.

    Returns:
        Durations of ``extract`` and ``match`` in seconds.
    """
    pycolmap = pycolmap_module()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV" if camera.has_distortion else "PINHOLE"
    K = camera.K
    numbers = [K[0, 0], K[1, 1], *to_colmap(K[:2, 2])]
    reader.camera_params = ",".join(
        map(str, [*numbers, *camera.distortion[:4]] if camera.has_distortion else numbers)
    )
    began = time.perf_counter()
    pycolmap.extract_features(
        database,
        images[0].parent,
        image_names=[p.name for p in images],
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        device=pycolmap.Device.cpu,
    )
    extracted = time.perf_counter()
    options = pycolmap.TwoViewGeometryOptions()
    for name, value in verification.items():
        setattr(options, name, value)
    pycolmap.match_exhaustive(database, verification_options=options, device=pycolmap.Device.cpu)
    return {"extract": extracted - began, "match": time.perf_counter() - extracted}


def two_view_inliers(image1: Path, image2: Path, camera: Camera) -> tuple[int, float]:
    """Return the number of verified matches of two photographs, and the duration in seconds."""
    pycolmap = pycolmap_module()
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        seconds = extract_and_match(database, (image1, image2), camera, compute_relative_pose=True)
        with pycolmap.Database.open(database) as db:
            _, geometries = db.read_two_view_geometries()
    return len(geometries[0].inlier_matches) if geometries else 0, sum(seconds.values())


def reconstruct(images: Sequence[Path], camera: Camera) -> ColmapModel:
    """Reconstruct a sparse model with COLMAP, with fixed intrinsics.

    COLMAP extracts features, matches all pairs and runs its incremental mapper. Points seen in only
    two photographs are kept, because all points of a two-view cloud are of this kind; COLMAP drops
    them by default.

    Args:
        images: Two or more photographs in one folder; the first two define frame and unit.

    Raises:
        InputError: pycolmap is not installed.
    """
    pycolmap = pycolmap_module()
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        seconds = extract_and_match(database, images, camera)
        began = time.perf_counter()
        models: dict[int, Any] = {}
        for angle in _PAIR_DEG if len(images) == 2 else _TRIES_DEG:
            options = pycolmap.IncrementalPipelineOptions()
            options.min_model_size, options.multiple_models = 2, False
            options.ba_refine_focal_length = options.ba_refine_extra_params = False
            options.triangulation.ignore_two_view_tracks = False
            options.mapper.init_min_tri_angle = angle
            models = pycolmap.incremental_mapping(
                database, images[0].parent, folder, options=options
            )
            if models:
                break
        seconds["map"] = time.perf_counter() - began
        if not models:
            return ColmapModel(None, seconds, (0, len(images)))
        model = max(models.values(), key=lambda m: m.num_reg_images())
        return ColmapModel(_cloud(model, images), seconds, (model.num_reg_images(), len(images)))


def _cloud(model: Any, images: Sequence[Path]) -> PointCloud | None:
    placed = {
        image.name: image.cam_from_world() for image in model.images.values() if image.has_pose
    }
    if not {images[0].name, images[1].name} <= placed.keys():
        return None
    first, second = (
        (p.rotation.matrix(), np.asarray(p.translation))
        for p in (placed[images[0].name], placed[images[1].name])
    )
    (R, t), (R2, t2) = first, second
    baseline = float(np.linalg.norm(R2.T @ t2 - R.T @ t))
    points = list(model.points3D.values())
    world = np.array([p.xyz for p in points]).reshape(-1, 3)
    n = len(points)
    return PointCloud(
        xyz=torch.from_numpy((world @ R.T + t) / baseline),
        rgb=torch.from_numpy(np.array([p.color for p in points], np.uint8).reshape(-1, 3)),
        operator_id=torch.zeros(n, dtype=torch.int64),
        operator_mask=torch.ones(n, dtype=torch.int64),
        operators=(NAME,),
        reprojection_error=torch.tensor([p.error for p in points], dtype=torch.float64),
        parallax=torch.full((n,), float("nan"), dtype=torch.float64),
        match=torch.full((n,), -1, dtype=torch.int64),
    )
