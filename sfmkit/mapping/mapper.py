"""COLMAP's mappers on a database of sfmkit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..io.colmap.engine import pycolmap_module

__all__ = ["INIT_ANGLES_DEG", "MapOptions", "Mapper", "run_mapper"]

Mapper = Literal["incremental", "global"]

# Least angle between the rays of the first pair: COLMAP's default, then smaller angles for
# photographs that were taken close together.
INIT_ANGLES_DEG = (16.0, 4.0, 1.5)


@dataclass(frozen=True)
class MapOptions:
    """Options of the mapper.

    Attributes:
        mapper: ``incremental`` or ``global``.
        two_view_points: Whether to keep points that are seen in only two photographs. They are the
            majority; COLMAP drops them by default, and dense methods do not need them.
        seed: Seed of the mapper.
        threads: Number of threads of the mapper; -1 for all. With several threads, the order of the
            sums in the bundle adjustment varies, and so does the model.
    """

    mapper: Mapper = "incremental"
    two_view_points: bool = False
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        if self.mapper not in ("incremental", "global"):
            raise InputError(f"the mapper must be 'incremental' or 'global', not {self.mapper!r}")
        if self.threads < 1 and self.threads != -1:
            raise InputError(f"threads must be at least 1, or -1 for all, not {self.threads}")


def run_mapper(
    database: Path,
    images: Path,
    work: Path,
    options: MapOptions | None = None,
    *,
    fixed_cameras: tuple[int, ...] = (),
) -> Any:
    """Map the photographs of a database.

    Args:
        database: Path of a database of :func:`sfmkit.mapping.database.write_database`.
        images: Folder of the photographs.
        work: An existing folder for intermediate results.
        options: See :class:`MapOptions`.
        fixed_cameras: Ids of cameras whose intrinsics are not refined.

    Returns:
        The ``pycolmap.Reconstruction`` with the most photographs; None without a model.

    Raises:
        InputError: pycolmap is not installed.
    """
    pycolmap = pycolmap_module()
    options = options or MapOptions()
    models: dict[int, Any] = {}
    if options.mapper == "global":
        settings = pycolmap.GlobalPipelineOptions()
        settings.random_seed, settings.num_threads = options.seed, options.threads
        settings.mapper.retriangulation.ignore_two_view_tracks = not options.two_view_points
        if fixed_cameras:
            # The global mapper does not support a list of fixed cameras.
            adjustment = settings.mapper.bundle_adjustment
            adjustment.refine_focal_length = adjustment.refine_extra_params = False
        models = pycolmap.global_mapping(database, images, work, settings)
    else:
        for angle in INIT_ANGLES_DEG:
            models = pycolmap.incremental_mapping(
                database, images, work, _incremental(pycolmap, options, fixed_cameras, angle)
            )
            if models:
                break
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def _incremental(
    pycolmap: Any, options: MapOptions, fixed_cameras: tuple[int, ...], angle_deg: float
) -> Any:
    settings = pycolmap.IncrementalPipelineOptions()
    settings.random_seed, settings.num_threads = options.seed, options.threads
    settings.multiple_models, settings.min_model_size = False, 2
    settings.extract_colors = False
    settings.constant_cameras = set(fixed_cameras)
    settings.mapper.constant_cameras = set(fixed_cameras)
    settings.mapper.init_min_tri_angle = angle_deg
    settings.triangulation.ignore_two_view_tracks = not options.two_view_points
    return settings


def poses_of(model: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return name -> R, t of the registered photographs, ``X_camera = R X_world + t``."""
    return {
        image.name: (pose.rotation.matrix(), np.asarray(pose.translation))
        for image in model.images.values()
        if image.has_pose
        for pose in [image.cam_from_world()]
    }
