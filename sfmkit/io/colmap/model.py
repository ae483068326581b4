"""COLMAP models in memory, in the conventions of sfmkit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import InputError
from ...types import Camera
from .cameras import ColmapCamera

NO_POINT = -1


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """A registered image.

    Attributes:
        name: Path relative to the folder of the images.
        camera_id: Id of its camera.
        R, t: (3, 3) and (3,) float64, ``X_camera = R X_world + t``.
        xy: (N, 2) float64 observed points, pixels, the centre of the top-left pixel at (0, 0).
        point_id: (N,) int64 ids of the points in the cloud, -1 for none.
    """

    name: str
    camera_id: int
    R: np.ndarray
    t: np.ndarray
    xy: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    point_id: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False)
class ColmapPoint:
    """A point of the cloud.

    Attributes:
        xyz: (3,) float64 position in the world.
        rgb: Red, green and blue, 0 to 255.
        error: Mean reprojection error, pixels.
        track: (L, 2) int64 image ids and rows of their observations.
    """

    xyz: np.ndarray
    rgb: tuple[int, int, int]
    error: float
    track: np.ndarray


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """Cameras, images and points by id."""

    cameras: Mapping[int, ColmapCamera]
    images: Mapping[int, ColmapImage]
    points: Mapping[int, ColmapPoint]

    def camera(self, image: ColmapImage) -> Camera:
        """Return the camera of an image.

        Raises:
            InputError: The model has no such camera, or its camera model is not supported.
        """
        if image.camera_id not in self.cameras:
            name = image.name[:80]
            raise InputError(f"there is no camera {image.camera_id} for the image {name}")
        try:
            return self.cameras[image.camera_id].camera()
        except InputError as error:
            raise InputError(
                f"camera {image.camera_id} of the image {image.name[:80]}: {error}"
            ) from None


class Images(dict[int, ColmapImage]):
    """Images by id, while they are read."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def add(self, key: int, image: ColmapImage) -> None:
        """Add an image.

        Raises:
            InputError: The id or the name exists already, or the name points outside the folder
                of the images.
        """
        _check_inside(image.name)
        if key in self:
            raise InputError(f"the image {key} is listed twice")
        if image.name in self._names:
            raise InputError(f"the image {image.name[:80]} is listed twice")
        self._names.add(image.name)
        self[key] = image


def image_path(folder: Path, name: str) -> Path:
    """Return the path of an image by its name, which must stay inside `folder`.

    Raises:
        InputError: The name is absolute, empty, too long, or contains ``..``.
    """
    _check_inside(name)
    return folder / name


def _check_inside(name: str) -> None:
    parts = PureWindowsPath(name).parts  # both separators
    absolute = PurePosixPath(name).is_absolute() or bool(PureWindowsPath(name).anchor)
    if absolute or ".." in parts or not parts or "\0" in name:
        raise InputError(f"the image name {name[:80]!r} leads out of the folder of the images")
    if max(len(os.fsencode(part)) for part in parts) > 255 or len(os.fsencode(name)) > 3000:
        raise InputError(f"the image name {name[:40]!r}... is too long for a file")


def check_pose(q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Convert a quaternion w, x, y, z and a translation to R (3, 3) and t (3,).

    Raises:
        InputError: A value is not finite, or the quaternion is zero.
    """
    if not (np.isfinite(q).all() and np.isfinite(t).all()):
        raise InputError("the pose holds NaN or infinite values")
    largest = np.abs(q).max()
    if not largest > 0:
        raise InputError("the quaternion of the pose is zero")
    return Rotation.from_quat(q / largest, scalar_first=True).as_matrix(), t


def quaternion(R: np.ndarray) -> np.ndarray:
    """Convert a rotation matrix to a quaternion w, x, y, z with w >= 0."""
    return Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
