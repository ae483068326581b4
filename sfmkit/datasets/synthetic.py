"""Rendered pairs of photographs with exact ground truth: cameras, pose, and depth of every pixel.

    >>> pair = render("courtyard", size_wh=(1024, 768), noise=1.5)
    >>> x2, visible = pair.transfer(np.array([[512.0, 300.0]]))

The geometry is analytic, so depths and correspondences are exact up to rounding. Only the colours
are sampled.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from ..errors import InputError
from ..types import Camera
from .rendering.raycasting import EXACT, geometry, radiance, rays
from .rendering.scenes import SCENES, Pose, Scene
from .rendering.textures import srgb

GAIN = 0.68  # sensor gain at exposure 1; the brightest matt surface in the sun is below white
OCCLUSION_TOLERANCE = 1e-6  # relative difference of depth
DEMO = {
    "scene": "courtyard",
    "size_wh": (1600, 1200),
    "blur": 0.8,
    "noise": 1.2,
    "jpeg_quality": 92,
    "seed": 0,
}


@dataclass(frozen=True, eq=False)
class SyntheticPair:
    """Two rendered photographs with their ground truth.

    Attributes:
        image1, image2: (H, W, 3) uint8 sRGB.
        camera1, camera2: True cameras.
        R, t: (3, 3) and (3,) float64 true pose, ``X2 = R X1 + t``, t in metres.
        depth1, depth2: (H, W) float64 depth z at the pixel centres, metres; inf for sky.
        points1: (H, W, 3) float64 points at the pixel centres of image 1, in the frame of camera 1,
            metres; NaN for sky.
        scene: The rendered scene.
        settings: Arguments of :func:`render`.
    """

    image1: np.ndarray
    image2: np.ndarray
    camera1: Camera
    camera2: Camera
    R: np.ndarray
    t: np.ndarray
    depth1: np.ndarray
    depth2: np.ndarray
    points1: np.ndarray
    scene: Scene
    settings: dict[str, Any]

    def depth_at(self, view: int, x: np.ndarray) -> np.ndarray:
        """Return the (N,) depths at pixels of an image, metres; inf for sky.

        Args:
            view: 1 or 2.
            x: (N, 2) pixels, which may be fractional.
        """
        camera, pose = {1: (self.camera1, self.scene.pose1), 2: (self.camera2, self.scene.pose2)}[
            view
        ]
        return self.scene.cast(*rays(camera.K, pose, _pixels(x).T), EXACT)[0]

    def transfer(self, x1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transfer pixels `x1` of image 1 to image 2 with the true depth.

        Args:
            x1: (N, 2) pixels of image 1, which may be fractional.

        Returns:
            (x2, visible). x2 is (N, 2) float64 pixels, NaN for points behind camera 2; sky is
            transferred as a point at infinity. visible is (N,) bool, False for points outside image
            2 and for occluded points.
        """
        x1 = _pixels(x1)
        z1 = self.depth_at(1, x1)
        sky = np.isinf(z1)
        ray = np.column_stack([x1, np.ones(len(x1))]) @ np.linalg.inv(self.camera1.K).T
        X2 = (
            np.where(sky, 1.0, z1)[:, None] * ray @ self.R.T
            + np.where(sky, 0.0, 1.0)[:, None] * self.t
        )
        x2 = np.full_like(x1, np.nan)
        ahead = X2[:, 2] > 0
        x2[ahead] = (X2[ahead] @ self.camera2.K.T)[:, :2] / X2[ahead, 2:]
        w, h = self.camera2.size_wh
        inside = ahead & ((x2 >= -0.5) & (x2 <= (w - 0.5, h - 0.5))).all(axis=1)
        visible = np.zeros(len(x1), dtype=bool)
        z2 = self.depth_at(2, x2[inside])
        same = np.abs(z2 - X2[inside, 2]) <= OCCLUSION_TOLERANCE * X2[inside, 2]
        visible[inside] = np.where(sky[inside], np.isinf(z2), same)
        return x2, visible

    def truth(self) -> dict[str, Any]:
        """Return the ground truth as JSON values, the format of ``reconstruct --truth``."""
        return {
            "convention": (
                "X2 = R X1 + t, metres; x right, y down, z forward; centre of the top-left pixel "
                "(0, 0)"
            ),
            "R": self.R.tolist(),
            "t": self.t.tolist(),
            "K": self.camera1.K.tolist(),
            "K2": self.camera2.K.tolist(),
            "size_wh": list(self.camera1.size_wh),
            "scene": self.scene.name,
            "settings": self.settings,
        }


def render(
    scene: str | Scene,
    *,
    size_wh: tuple[int, int] = (1024, 768),
    blur: float = 0.0,
    noise: float = 1.0,
    exposure: float = 1.0,
    jpeg_quality: int | None = None,
    seed: int = 0,
    supersample: int = 2,
) -> SyntheticPair:
    """Render two photographs of a scene, with ground truth.

    The same arguments give bit-identical results on the same machine.

    Args:
        scene: Name in :data:`SCENES`, or a :class:`Scene`.
        size_wh: Width and height of both images, at least 16 pixels each.
        blur: Standard deviation of the Gaussian blur of the lens, pixels.
        noise: Standard deviation of the sensor noise, grey levels.
        exposure: Factor on the light before the sensor clips.
        jpeg_quality: JPEG quality from 1 to 100 to compress both images; None for no compression.
        seed: Seed of the noise; the scene does not depend on it.
        supersample: Number of rays per side of a pixel, 1 to 8.

    Raises:
        InputError: The scene is unknown, or a value is out of range.
    """
    if isinstance(scene, str):
        scene = named_scene(scene)
    w, h = check_size(size_wh)
    _positive("blur", blur, zero=True)
    _positive("noise", noise, zero=True)
    _positive("exposure", exposure)
    if jpeg_quality is not None:
        _whole("jpeg_quality", jpeg_quality, 1, 100)
    _whole("supersample", supersample, 1, 8)
    _whole("seed", seed, 0, 2**63)

    K = scene.K((w, h))
    images, depths, points = [], [], []
    for view, pose in enumerate((scene.pose1, scene.pose2)):
        light = radiance(scene, pose, K, (w, h), supersample)
        images.append(
            photograph(
                light, blur, noise, exposure, jpeg_quality, np.random.default_rng((seed, view))
            )
        )
        depth, X = geometry(scene, pose, K, (w, h))
        depths.append(depth)
        points.append(X)
    R, t = relative_pose(scene.pose1, scene.pose2)
    settings = {
        "blur": blur,
        "noise": noise,
        "exposure": exposure,
        "jpeg_quality": jpeg_quality,
        "seed": seed,
        "supersample": supersample,
    }
    camera = Camera(K, (w, h))
    return SyntheticPair(
        images[0], images[1], camera, camera, R, t, depths[0], depths[1], points[0], scene, settings
    )


@cache
def named_scene(name: str) -> Scene:
    """Return a scene by name.

    Raises:
        InputError: There is no such scene; the message suggests the closest name.
    """
    if name not in SCENES:
        near = get_close_matches(name, SCENES, n=1, cutoff=0.4)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        raise InputError(f"unknown scene '{name}'.{hint} Known: {', '.join(SCENES)}.")
    return SCENES[name]()


def relative_pose(pose1: Pose, pose2: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Compute ``R, t`` of ``X2 = R X1 + t`` from two poses in the world."""
    R = pose2.R @ pose1.R.T
    return R, pose2.R @ (pose1.centre - pose2.centre)


def photograph(
    light: np.ndarray,
    blur: float,
    noise: float,
    exposure: float,
    jpeg_quality: int | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Convert linear light (H, W, 3) to an image.

    The steps are blur, exposure, sRGB curve, noise, quantisation to 8 bits and JPEG.
    """
    if blur > 0:
        light = gaussian_filter(light, (blur, blur, 0), mode="nearest")
    levels = 255 * srgb(GAIN * exposure * light)
    if noise > 0:
        levels = levels + noise * rng.standard_normal(levels.shape)
    image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    if jpeg_quality is None:
        return image
    memory = io.BytesIO()
    Image.fromarray(image).save(memory, "JPEG", quality=int(jpeg_quality))
    return np.asarray(Image.open(memory)).copy()


def _pixels(x: np.ndarray) -> np.ndarray:
    x = np.asarray(x, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != 2:
        raise InputError(f"pixels must have shape (N, 2), not {x.shape}")
    return x


def check_size(size_wh: tuple[int, int]) -> tuple[int, int]:
    """Check an image size, and return it.

    Raises:
        InputError: Width or height is not an integer of at least 16 pixels.
    """
    if not isinstance(size_wh, Sequence) or len(size_wh) != 2:
        raise InputError(f"size_wh must be (width, height) in pixels, not {size_wh!r}")
    return _whole("size_wh", size_wh[0], 16, 20_000), _whole("size_wh", size_wh[1], 16, 20_000)


def _whole(name: str, value: Any, low: int, high: int) -> int:
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, np.integer))
        or not low <= value <= high
    ):
        raise InputError(f"{name} must be whole and between {low} and {high}, not {value!r}")
    return int(value)


def _positive(name: str, value: float, zero: bool = False) -> None:
    if not np.isfinite(value) or value < 0 or (value == 0 and not zero):
        raise InputError(f"{name} must be {'zero or ' if zero else ''}positive, not {value!r}")


# ---- the bundled example ----


def demo_pair() -> tuple[Path, Path, Path]:
    """Return the paths of the two bundled photographs and of their ground truth.

    The ground truth is JSON, see :meth:`SyntheticPair.truth`.
    """
    folder = Path(str(files("sfmkit.datasets") / "demo"))
    return folder / "image1.jpg", folder / "image2.jpg", folder / "truth.json"


def write_demo(folder: Path) -> None:
    """Render the bundled pair into `folder`: ``image1.jpg, image2.jpg, truth.json``."""
    quality = int(DEMO["jpeg_quality"])  # type: ignore[call-overload]
    pair = render(**{**DEMO, "jpeg_quality": None, "supersample": 3})  # type: ignore[arg-type]
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in (("image1.jpg", pair.image1), ("image2.jpg", pair.image2)):
        Image.fromarray(image).save(folder / name, quality=quality)
    truth = pair.truth()
    truth["settings"]["jpeg_quality"] = quality
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m sfmkit.datasets.synthetic", description=write_demo.__doc__
    )
    parser.add_argument(
        "--write-demo", metavar="DIR", type=Path, required=True, help="render it into DIR"
    )
    write_demo(parser.parse_args().write_demo)


if __name__ == "__main__":
    main()
