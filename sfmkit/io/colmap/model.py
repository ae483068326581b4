"""A COLMAP model in memory, in the conventions of this package."""

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
        name: path relative to the folder of the images.
        camera_id: of its camera.
        R, t: (3, 3) and (3,) float64, ``X_camera = R X_world + t``.
        xy: (N, 2) float64 observed points, pixels, the centre of the top-left pixel at (0, 0).
        point_id: (N,) int64 of the points in the cloud, -1 for none.
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
        xyz: (3,) float64 in the world.
        rgb: red, green and blue, 0 to 255.
        error: mean reprojection error, pixels.
        track: (L, 2) int64 of image ids and rows of their observations.
    """

    xyz: np.ndarray
    rgb: tuple[int, int, int]
    error: float
    track: np.ndarray


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """Cameras, images and points by their ids."""

    cameras: Mapping[int, ColmapCamera]
    images: Mapping[int, ColmapImage]
    points: Mapping[int, ColmapPoint]

    def camera(self, image: ColmapImage) -> Camera:
        """Return the camera of an image.

        Raises:
            InputError: the model has no such camera, or its lens is not supported.
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
    """Images by their ids while they are read."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def add(self, key: int, image: ColmapImage) -> None:
        """Add an image.

        Raises:
            InputError: an id or a name that is there already, or a name that leads out of the
                images' folder.
        """
        _check_inside(image.name)
        if key in self:
            raise InputError(f"the image {key} is listed twice")
        if image.name in self._names:
            raise InputError(f"the image {image.name[:80]} is listed twice")
        self._names.add(image.name)
        self[key] = image


def image_path(folder: Path, name: str) -> Path:
    """The file of an image's name, which must stay inside `folder`.

    Raises:
        InputError: an absolute path, one with ``..``, or an empty one.
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
    """R (3, 3) and t (3,) of a quaternion w, x, y, z and a translation.

    Raises:
        InputError: values that are not finite, or a quaternion of length zero.
    """
    if not (np.isfinite(q).all() and np.isfinite(t).all()):
        raise InputError("the pose holds NaN or infinite values")
    largest = np.abs(q).max()
    if not largest > 0:
        raise InputError("the quaternion of the pose is zero")
    return Rotation.from_quat(q / largest, scalar_first=True).as_matrix(), t


def quaternion(R: np.ndarray) -> np.ndarray:
    """The quaternion w, x, y, z of a rotation matrix, w not negative."""
    return Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
