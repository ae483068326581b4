"""Rendered planes with exact homographies, in the manner of the Oxford sequences.

Each sequence has a first image and five images with a growing change: zoom and rotation, blur,
viewpoint, light or JPEG compression (Mikolajczyk et al., "A comparison of
affine region detectors", IJCV 2005). The texture of the plane is a function of its coordinates and
is evaluated at every pixel, so no image is warped.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from ..errors import InputError
from .generated import generated
from .pair import Pair
from .rendering import materials as m
from .rendering.raycasting import in_parallel
from .rendering.surfaces import Material, unit
from .synthetic import check_size, photograph

Array = np.ndarray

FOCAL = 1.1  # focal length over image width
DISTANCE = 4.4  # of the camera from the plane, metres
LIGHT = unit(np.array([-0.5, -0.6, 0.75]))  # towards the sun; u, v and out of the plane
ROWS = 32  # pixel rows that are rendered at a time


@dataclass(frozen=True)
class View:
    """The camera settings of one image of a plane.

    Attributes:
        zoom: Scale of the image relative to the first one.
        roll, yaw, pitch: Degrees about the optical axis, and about the vertical and horizontal axes
            of the plane.
        shift: Translation of the image centre on the plane in metres.
        blur, exposure, jpeg_quality: See :func:`sfmkit.datasets.synthetic.render`.
    """

    zoom: float = 1.0
    roll: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    blur: float = 0.5
    exposure: float = 1.0
    jpeg_quality: int | None = None

    def pixels_from_plane(self, size_wh: tuple[int, int]) -> Array:
        """(3, 3) homography from (u, v) in metres on the plane to pixels.

        ``K [r1 r2 t]`` (Hartley and Zisserman, section 8.1).
        """
        w, h = size_wh
        f = FOCAL * w
        K = np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1]])
        R = _turn(2, self.roll) @ _turn(1, self.yaw) @ _turn(0, self.pitch)
        t = np.array([0, 0, DISTANCE / self.zoom]) - R @ np.array([*self.shift, 0])
        return K @ np.column_stack([R[:, 0], R[:, 1], t])


def _turn(axis: int, degrees: float) -> Array:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


_WALL = m.with_decals(
    m.mural,
    ("poster", 3, (-1.5, -1.35, -0.6, -0.15)),
    ("poster", 4, (0.75, 0.05, 1.5, 1.05)),
    ("graffiti", 2, (-1.6, 0.0, 0.5, 1.5)),
    ("graffiti", 1, (-0.1, -1.5, 1.8, 0.1)),
    ("graffiti", 5, (-4.2, -1.2, -2.2, 0.8)),
    ("graffiti", 6, (2.0, 0.4, 3.9, 2.2)),
    ("poster", 7, (2.2, -1.7, 3.2, -0.4)),
    ("poster", 8, (-3.4, 1.0, -2.4, 2.2)),
)
_BRICKS = m.with_decals(m.brick, ("graffiti", 6, (-1.4, -0.9, 0.6, 0.8)))
_GATE = m.with_decals(
    m.planks(0.17, "#8a6d4a", nails=0.6),
    ("poster", 8, (-0.3, -1.1, 0.8, 0.4)),
    ("graffiti", 1, (-1.9, -0.2, -0.2, 1.3)),
)

#: name -> texture of the plane, and views 2 to 6; view 1 is ``View()``.
SEQUENCES: dict[str, tuple[Material, tuple[View, ...]]] = {
    "zoom_rotation": (
        _WALL,
        tuple(
            View(zoom=z, roll=a, shift=(0.05, -0.03))
            for z, a in ((0.85, 10), (0.7, -22), (0.58, 45), (0.47, 80), (0.38, 150))
        ),
    ),
    "blur": (
        m.cobbles,
        tuple(
            View(blur=b, shift=(0.02 * b, -0.01), roll=0.3 * b) for b in (1.2, 1.9, 2.7, 3.6, 4.6)
        ),
    ),
    "viewpoint": (
        _BRICKS,
        tuple(
            View(yaw=a, pitch=-0.15 * a, zoom=0.95, shift=(-0.003 * a, 0))
            for a in (18, 30, 40, 50, 58)
        ),
    ),
    "light": (
        _WALL,
        tuple(
            View(exposure=e, shift=(0.03, 0.02), roll=-0.8) for e in (0.6, 0.38, 0.25, 0.16, 0.1)
        ),
    ),
    "jpeg": (_GATE, tuple(View(jpeg_quality=q) for q in (40, 20, 12, 7, 3))),
}


def homography(first: View, other: View, size_wh: tuple[int, int]) -> Array:
    """Compute the (3, 3) ``x2 = H x1`` between pixels of two views, with ``H[2, 2] = 1``."""
    H = other.pixels_from_plane(size_wh) @ np.linalg.inv(first.pixels_from_plane(size_wh))
    return H / H[2, 2]


def photograph_plane(
    material: Material,
    view: View,
    *,
    size_wh: tuple[int, int] = (800, 640),
    noise: float = 1.0,
    seed: int = 0,
) -> Array:
    """Render a plane of `material` as an (H, W, 3) uint8 image, with 2 x 2 rays per pixel.

    Raises:
        InputError: The size is not valid.
    """
    w, h = check_size(size_wh)
    G = np.linalg.inv(view.pixels_from_plane(size_wh))
    area = abs(np.linalg.det(G))
    quarter = np.array([-0.25, 0.25])
    film = np.empty((h, w, 3), dtype=np.float32)

    def part(top: int) -> None:
        rows = np.arange(top, min(top + ROWS, h))
        x, y = np.meshgrid(
            (np.arange(w)[:, None] + quarter).ravel(), (rows[:, None] + quarter).ravel()
        )
        u, v, q = (G[i, 0] * x.ravel() + G[i, 1] * y.ravel() + G[i, 2] for i in range(3))
        # the Jacobian det G / q^3 takes the area of a pixel to the plane
        footprint = 0.5 * np.sqrt(area / np.abs(q) ** 3)
        albedo, slope = material(u / q, v / q, footprint)
        if slope is not None:
            normal = unit(np.stack([-slope[:, 0], -slope[:, 1], np.ones(len(slope))]))
            albedo = albedo * (np.maximum(LIGHT @ normal, 0) / LIGHT[2]).astype(np.float32)[:, None]
        film[rows] = albedo.reshape(len(rows), 2, w, 2, 3).mean(axis=(1, 3))

    in_parallel(part, range(0, h, ROWS))
    rng = np.random.default_rng(seed)
    return photograph(2.2 * film, view.blur, noise, view.exposure, view.jpeg_quality, rng)


@generated(SEQUENCES)
def planes(
    root: str | os.PathLike | None = None,
    sequences: Iterable[str] | None = None,
    *,
    size_wh: tuple[int, int] = (800, 640),
    noise: float = 1.0,
    seed: int = 0,
) -> Iterator[Pair]:
    """Yield the pairs 1-2 ... 1-6 of each sequence, rendered on demand, with the exact H.

    Args:
        root: Ignored: nothing is read from the disk.
        sequences: Names in :data:`SEQUENCES`; None for all.
        size_wh: Width and height of the images in pixels.
        noise: Standard deviation of the sensor noise in grey levels.
        seed: Seed of the noise.

    Raises:
        InputError: A sequence is unknown, or the size is not valid.
    """
    for name in tuple(SEQUENCES) if sequences is None else tuple(sequences):
        if name not in SEQUENCES:
            near = get_close_matches(name, SEQUENCES, n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise InputError(f"unknown sequence '{name}'.{hint} Known: {', '.join(SEQUENCES)}")
        material, views = SEQUENCES[name]
        first = photograph_plane(material, View(), size_wh=size_wh, noise=noise, seed=6 * seed)
        for k, view in enumerate(views, start=2):
            image = photograph_plane(
                material, view, size_wh=size_wh, noise=noise, seed=6 * seed + k - 1
            )
            yield Pair("planes", name, f"1-{k}", first, image, H=homography(View(), view, size_wh))
