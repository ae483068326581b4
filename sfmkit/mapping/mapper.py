"""Cameras and points of many photographs, by COLMAP's mappers on a database of sfmkit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..io.colmap.engine import pycolmap_module

__all__ = ["INIT_ANGLES_DEG", "MapOptions", "Mapper", "run_mapper"]

Mapper = Literal["incremental", "global"]

# Least angle between the rays of the first pair: COLMAP's own, then less, for photographs that
# were taken close together.
INIT_ANGLES_DEG = (16.0, 4.0, 1.5)


@dataclass(frozen=True)
class MapOptions:
    """How photographs are mapped.

    Attributes:
        mapper: ``incremental`` or ``global``.
        two_view_points: Keep points that only two photographs show. COLMAP leaves them out, and
            they are the majority; a dense method does without them.
        seed: Of the mapper.
        threads: Of the mapper; -1 for all. With several threads the bundle adjustment adds in an
            order that varies, and so does the model from run to run.
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
        database: As :func:`sfmkit.mapping.database.write_database` writes it.
        images: The folder of the photographs.
        work: An existing folder for intermediate results.
        options: See :class:`MapOptions`.
        fixed_cameras: Ids of cameras whose intrinsics are not refined.

    Returns:
        The ``pycolmap.Reconstruction`` with the most photographs; None where there is none.

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
            # The global mapper has no list of fixed cameras.
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
    """Name -> R (3, 3) and t (3,) of every registered photograph, ``X_camera = R X_world + t``."""
    return {
        image.name: (pose.rotation.matrix(), np.asarray(pose.translation))
        for image in model.images.values()
        if image.has_pose
        for pose in [image.cam_from_world()]
    }
