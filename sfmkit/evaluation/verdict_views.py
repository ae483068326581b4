"""Photographs of the benchmark of verdicts, reduced in size, with cameras and poses.

Rendered photographs are stored in the folder of the benchmark, so that each is rendered once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from .._utils.writing import atomic_write
from ..datasets.middlebury import temple_places
from ..datasets.oxford import oxford
from ..datasets.rendering import SCENES, Pose, Scene, geometry, radiance
from ..datasets.rendering.repeated import KINDS, repeated_scene, repeated_views
from ..datasets.strecha import strecha
from ..datasets.synthetic import photograph
from ..datasets.uav import uav
from ..io.cameras import camera_from_exif, centred_camera
from ..io.images import read_image
from ..io.truth import read_truth
from ..types import Camera

__all__ = ["BenchView", "overlap", "photographs", "rendered", "repeated", "temple"]

LONGEST = 512  # longest side of a reduced photograph, pixels
RENDERED_WH = (480, 360)
VARIATIONS = (0.0, 0.3, 1.0)
_COARSE_WH = (48, 36)  # grid on which the overlap of two rendered views is measured

Placed = tuple[np.ndarray, np.ndarray]  # R, t with x_cam = R X + t


@dataclass(frozen=True, eq=False)
class BenchView:
    """A photograph of the benchmark.

    Attributes:
        scene, name: Scene and name of the photograph; poses of one scene have a common frame.
        image: (H, W, 3) uint8.
        camera: Its intrinsics.
        pose: R, t with ``x_cam = R X + t``; None if it is unknown.
        rendering: Scene and pose of a rendered photograph.
    """

    scene: str
    name: str
    image: np.ndarray
    camera: Camera
    pose: Placed | None = None
    rendering: tuple[Scene, Pose] | None = None

    def cropped(self, name: str, left: int, right: int) -> BenchView:
        """Crop to the columns from `left` (inclusive) to `right` (exclusive), without a pose."""
        K = self.camera.K.copy()
        K[0, 2] -= left
        image = np.ascontiguousarray(self.image[:, left:right])
        camera = Camera(K, (right - left, image.shape[0]), source=self.camera.source)
        return replace(self, name=name, image=image, camera=camera, pose=None, rendering=None)

    def mirrored(self, name: str, axis: int) -> BenchView:
        """Mirror the photograph: left to right for axis 1, upside down for axis 0."""
        K, (w, h) = self.camera.K.copy(), self.camera.size_wh
        k = 0 if axis == 1 else 1
        K[k, 2] = (w, h)[k] - 1 - K[k, 2]
        image = np.ascontiguousarray(np.flip(self.image, axis))
        camera = Camera(K, (w, h), source=self.camera.source)
        return replace(self, name=name, image=image, camera=camera, pose=None, rendering=None)


def _reduced(
    scene: str, name: str, path: Path | np.ndarray, camera: Camera | None, pose: Placed | None
) -> BenchView:
    """Read a photograph and reduce it to the size of the benchmark."""
    image = read_image(path)
    w, h = image.size_wh
    camera = camera or centred_camera(1.2 * max(w, h), (w, h), "guessed")
    scale = min(1.0, LONGEST / max(w, h))
    size = (round(w * scale), round(h * scale))
    pixels = image.rgb if scale == 1 else cv2.resize(image.rgb, size, interpolation=cv2.INTER_AREA)
    return BenchView(scene, name, pixels, camera.scaled(size), pose)


def photographs(data: str | os.PathLike | None) -> dict[str, list[BenchView]]:
    """Read fountain, temple ring, drone and the first images of the Oxford set, by scene."""
    views = {"fountain": fountain(data), "temple": temple(data), "drone": drone(data)}
    for pair in oxford(data):
        if pair.sequence not in views:
            views[pair.sequence] = [_reduced(pair.sequence, "1", pair.image1, None, None)]
    return views


def fountain(data: str | os.PathLike | None) -> list[BenchView]:
    """Read the eleven views of the EPFL fountain in their order along the arc."""
    pairs = list(strecha(data, ["fountain-P11"]))
    files = [pairs[0].image1, *(pair.image2 for pair in pairs)]
    cameras = [pairs[0].camera1, *(pair.camera2 for pair in pairs)]
    views = []
    for file, camera in zip(files, cameras):
        assert isinstance(file, Path)
        truth = file.parents[1] / "gt_dense_cameras"
        pose = read_truth(truth, files[0], file)  # type: ignore[arg-type]
        views.append(_reduced("fountain", file.stem, file, camera, pose))
    return views


def temple(data: str | os.PathLike | None) -> list[BenchView]:
    """Read the temple ring in order, without the second of two photographs from one position."""
    return [
        _reduced("temple", f"{k:02d}", view.path, view.camera, (view.R, view.t))
        for k, view in enumerate(temple_places(data))
    ]


def drone(data: str | os.PathLike | None) -> list[BenchView]:
    """Read the photographs of the first flight, with cameras from EXIF and without poses."""
    pairs = list(uav(data))
    pairs = [pair for pair in pairs if pair.sequence == pairs[0].sequence]
    files = [pairs[0].image1, *(pair.image2 for pair in pairs)]
    cameras = [camera_from_exif(read_image(file)) for file in files]
    return [
        _reduced("drone", f"{k}", file, camera, None)
        for k, (file, camera) in enumerate(zip(files, cameras))
    ]


def rendered(folder: Path) -> Iterator[tuple[str, BenchView, BenchView]]:
    """Render or read the two views of each named scene."""
    for name in SCENES:
        scene = SCENES[name]()
        first, second = (
            _rendered(folder, name, str(k), scene, pose)
            for k, pose in enumerate((scene.pose1, scene.pose2), start=1)
        )
        yield name, first, second


def repeated(folder: Path) -> Iterator[list[BenchView]]:
    """Render or read the views of each scene of repeated texture."""
    for kind in KINDS:
        for variation in VARIATIONS:
            scene = repeated_scene(kind, variation)
            yield [
                _rendered(folder, scene.name, str(k), scene, pose)
                for k, pose in enumerate(repeated_views(kind))
            ]


def _rendered(folder: Path, scene: str, name: str, model: Scene, pose: Pose) -> BenchView:
    """Read a rendered photograph, or render and store it."""
    file = folder / f"{scene}-{name}.png"
    K = model.K(RENDERED_WH)
    if file.is_file():
        image = read_image(file).rgb
    else:
        light = radiance(model, pose, K, RENDERED_WH, 2)
        image = photograph(light, 0.5, 1.0, 1.0, None, np.random.default_rng((7, ord(name[-1]))))
        folder.mkdir(parents=True, exist_ok=True)
        encoded = cv2.imencode(".png", image[..., ::-1])[1]
        with atomic_write(file) as temporary:
            temporary.write_bytes(encoded.tobytes())
    placed = (pose.R, -pose.R @ pose.centre)
    return BenchView(scene, name, image, Camera(K, RENDERED_WH), placed, (model, pose))


@cache
def _points(scene: Scene, pose: Pose) -> np.ndarray:
    """Return the (N, 3) world points seen on a coarse pixel grid."""
    _, points = geometry(scene, pose, scene.K(_COARSE_WH), _COARSE_WH)
    X = points.reshape(-1, 3)
    return X[np.isfinite(X).all(1)] @ pose.R + pose.centre


def overlap(view1: BenchView, view2: BenchView) -> float:
    """Compute the overlap of two views: the share of each view's points inside the other one.

    The smaller share is returned. Occlusion is ignored.
    """
    assert view1.rendering is not None
    assert view2.rendering is not None
    shares = []
    for (scene, pose), (_, other) in (
        (view1.rendering, view2.rendering),
        (view2.rendering, view1.rendering),
    ):
        X = (_points(scene, pose) - other.centre) @ other.R.T
        x = X @ scene.K(_COARSE_WH).T
        x = x[:, :2] / x[:, 2:]
        inside = (X[:, 2] > 0) & ((x >= -0.5) & (x < np.array(_COARSE_WH) - 0.5)).all(1)
        shares.append(float(inside.mean()) if len(X) else 0.0)
    return min(shares)
