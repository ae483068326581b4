"""Ray casting: linear light and depth of every pixel of a pinhole camera.

Surfaces are Lambertian and lit by a sun with sharp shadows and by the sky. The visible share of the
sky is computed by casting rays from a coarse grid on every surface. The light of a point therefore
does not depend on the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.ndimage import uniform_filter

from .scenes import Pose, Scene
from .surfaces import Rectangle, Surface, blocked, dot, unit
from .textures import BROAD, FINE, linear, noise, ramp

Array = np.ndarray
T = TypeVar("T")
V = TypeVar("V")

EXACT, QUICK = 400, 10  # steps of the intersection with a relief, for geometry and colours
TILE = 128
SUN, SKY_LIGHT = 3.0 * linear("#fff1d6"), 1.15 * linear("#cfe0f5")
BOUNCE = 0.30 * linear("#f0d9bb")  # light reflected by the surroundings


def rays(K: Array, pose: Pose, x: Array) -> tuple[Array, Array]:
    """Compute origin (3, 1) and directions (3, N) of the rays through pixels `x` (2, N).

    They are in the world frame, and the parameter s of a ray is the depth.
    """
    skew = K[0, 1]
    yn = (x[1] - K[1, 2]) / K[1, 1]
    xn = (x[0] - K[0, 2] - skew * yn) / K[0, 0]
    R = pose.R
    direction = np.stack([R[0, k] * xn + R[1, k] * yn + R[2, k] for k in range(3)])
    return pose.centre[:, None], direction


def geometry(scene: Scene, pose: Pose, K: Array, size_wh: tuple[int, int]) -> tuple[Array, Array]:
    """Compute depth and points at the pixel centres.

    Returns:
        (H, W) depth, inf for sky, and (H, W, 3) points in the frame of the camera, NaN for sky.
    """
    w, h = size_wh
    depth, points = np.empty((h, w)), np.empty((h, w, 3))

    def part(tile: Tile) -> None:
        y, x = np.mgrid[tile.rows, tile.columns].astype(np.float64)
        s = scene.cast(*rays(K, pose, np.stack([x.ravel(), y.ravel()])), EXACT, tile.seen)[
            0
        ].reshape(x.shape)
        yn = (y - K[1, 2]) / K[1, 1]
        xn = (x - K[0, 2] - K[0, 1] * yn) / K[0, 0]
        depth[tile.rows, tile.columns] = s
        s = np.where(np.isfinite(s), s, np.nan)
        points[tile.rows, tile.columns] = np.stack([xn * s, yn * s, s], axis=-1)

    in_parallel(part, _tiles(scene, pose, K, size_wh))
    return depth, points


def radiance(
    scene: Scene, pose: Pose, K: Array, size_wh: tuple[int, int], supersample: int
) -> Array:
    """Render (H, W, 3) float32 linear light, the mean of ``supersample ** 2`` rays per pixel."""
    w, h = size_wh
    film = np.empty((h, w, 3), dtype=np.float32)
    offset = (np.arange(supersample) + 0.5) / supersample - 0.5

    def part(tile: Tile) -> None:
        xs = (np.arange(w)[tile.columns, None] + offset).ravel()
        ys = (np.arange(h)[tile.rows, None] + offset).ravel()
        x = np.stack([np.tile(xs, len(ys)), np.repeat(ys, len(xs))])
        light = _shade(scene, *rays(K, pose, x), 1 / (K[0, 0] * supersample), tile.seen)
        shape = (len(ys) // supersample, supersample, len(xs) // supersample, supersample, 3)
        film[tile.rows, tile.columns] = light.reshape(shape).mean(axis=(1, 3))

    in_parallel(part, _tiles(scene, pose, K, size_wh))
    return film


class Tile(NamedTuple):
    """A part of the image and the surfaces that may be visible in it."""

    rows: slice
    columns: slice
    seen: tuple[int, ...]


def _tiles(scene: Scene, pose: Pose, K: Array, size_wh: tuple[int, int]) -> list[Tile]:
    w, h = size_wh
    extents = [_extent(surface, pose, K) for surface in scene.surfaces]
    tiles = []
    for y0 in range(0, h, TILE):
        for x0 in range(0, w, TILE):
            x1, y1 = min(x0 + TILE, w), min(y0 + TILE, h)
            seen = (
                k
                for k, e in enumerate(extents)
                if e[0] < x1 and e[2] > x0 - 1 and e[1] < y1 and e[3] > y0 - 1
            )
            tiles.append(Tile(slice(y0, y1), slice(x0, x1), tuple(seen)))
    return tiles


def in_parallel(job: Callable[[T], V], parts: Iterable[T]) -> list[V]:
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(job, parts))


def _extent(surface: Surface, pose: Pose, K: Array) -> tuple[float, float, float, float]:
    """Compute the bounding box (left, top, right, bottom) of the surface, pixels."""
    X = (surface.corners() - pose.centre) @ pose.R.T
    if X[:, 2].max() < 0.01:
        return np.inf, np.inf, -np.inf, -np.inf
    if X[:, 2].min() < 0.01:
        return -np.inf, -np.inf, np.inf, np.inf
    x = (X @ K.T)[:, :2] / X[:, 2:]
    return (*(x.min(axis=0) - 1), *(x.max(axis=0) + 1))


def _shade(
    scene: Scene, origin: Array, direction: Array, pixel: float, seen: tuple[int, ...]
) -> Array:
    """Compute the (N, 3) light along rays; `pixel` is the angle between neighbouring rays."""
    s, index, u, v = scene.cast(origin, direction, QUICK, seen)
    light = np.empty((len(s), 3), dtype=np.float32)
    (sky,) = np.nonzero(index < 0)
    light[sky] = _sky(direction[:, sky], pixel)
    for k in seen:
        (at,) = np.nonzero(index == k)
        if len(at):
            light[at] = _matt(scene, k, origin, direction[:, at], s[at], u[at], v[at], pixel)
    return light


def _matt(
    scene: Scene,
    k: int,
    origin: Array,
    direction: Array,
    s: Array,
    u: Array,
    v: Array,
    pixel: float,
) -> Array:
    surface = scene.surfaces[k]
    point = origin + s * direction
    footprint = s * pixel
    normal, slope_u, slope_v = surface.frame(point, u, v, footprint)
    facing = -dot(normal, direction)
    normal = np.where(facing < 0, -normal, normal)  # a dish has two sides
    cosine = np.abs(facing) / np.sqrt(dot(direction, direction))
    footprint = footprint / np.sqrt(np.maximum(cosine, 0.05))
    albedo, bumps = surface.material(u, v, footprint)
    if bumps is not None:
        slope_u, slope_v = slope_u + bumps[:, 0], slope_v + bumps[:, 1]
    bumped = normal
    if bumps is not None or np.any(slope_u) or np.any(slope_v):
        eu, ev = (a[:, None] for a in surface.axes[:2])  # type: ignore[attr-defined]
        bumped = unit(normal - slope_u * eu - slope_v * ev)
    to_sun = scene.sun[:, None]
    lit = np.where(dot(normal, to_sun) > 0, np.maximum(dot(bumped, to_sun), 0), 0)
    (facing_sun,) = np.nonzero(lit > 0)
    lit[facing_sun[scene.shaded(point[:, facing_sun] + 1e-4 * normal[:, facing_sun])]] = 0
    tilt = 0.75 + 0.25 * np.clip(dot(bumped, normal) - 0.35 * bumped[1] + 0.35 * normal[1], 0, 1.3)
    ambient = _ambient_at(scene, k, u, v, normal, tilt)
    return albedo * (lit.astype(np.float32)[:, None] * SUN + ambient)


def _sky(direction: Array, pixel: float) -> Array:
    """Compute the colour of the sky, which depends on the direction only."""
    d = unit(direction)
    up = np.clip(-d[1], 0, 1)
    scale = 1 / (up + 0.25)
    n = noise().sample(
        0.16 * d[0] * scale + 0.3, 0.16 * d[2] * scale, np.full(len(up), 0.16 * pixel)
    )
    cloud = (ramp(n[:, BROAD] + 0.35 * n[:, FINE], 0.45, 1.6) * ramp(up, 0.06, 0.1)).astype(
        np.float32
    )[:, None]
    blue = linear("#a9c4e4") + up.astype(np.float32)[:, None] * (
        linear("#4f86c6") - linear("#a9c4e4")
    )
    return 1.25 * (blue + cloud * (linear("#f4f4f2") - blue))


# ---- light from the sky and the surroundings ----

CELL = 0.18  # grid spacing, metres
SPOKES = 32  # rays per cell


@lru_cache(maxsize=8)
def _openness(surfaces: tuple[Surface, ...]) -> tuple[Array | None, ...]:
    """Compute the cosine-weighted visible share of the sky on a grid, for each flat surface."""
    return tuple(in_parallel(lambda surface: _open_grid(surfaces, surface), surfaces))


def _open_grid(surfaces: tuple[Surface, ...], surface: Surface) -> Array | None:
    if not isinstance(surface, Rectangle):
        return None
    (w, h), (eu, ev, n) = surface.size, surface.axes
    cols, rows = max(2, int(np.ceil(w / CELL)) + 1), max(2, int(np.ceil(h / CELL)) + 1)
    inset = 0.004 * min(w, h)
    v, u = np.meshgrid(
        np.linspace(inset, h - inset, rows), np.linspace(inset, w - inset, cols), indexing="ij"
    )
    base = (
        surface.corner[:, None]
        + eu[:, None] * u.ravel()
        + ev[:, None] * v.ravel()
        + 0.004 * n[:, None]
    )
    k = np.arange(SPOKES) + 0.5
    turn = np.random.default_rng(5).random(u.size)
    angle = (
        2 * np.pi * (k[:, None] * 0.6180339887 + turn)
    )  # a spiral over the hemisphere, turned from cell to cell
    radius = np.sqrt(k / SPOKES)[:, None]
    out = np.sqrt(1 - radius**2)
    spokes = [
        eu[i] * radius * np.cos(angle) + ev[i] * radius * np.sin(angle) + n[i] * out
        for i in range(3)
    ]
    direction = np.stack(spokes).reshape(3, -1)
    start = np.broadcast_to(base[:, None], (3, SPOKES, u.size)).reshape(3, -1)
    before = [other for other in surfaces if ((other.corners() - surface.corner) @ n).max() > 1e-6]
    free = ~blocked(before, start, direction)
    # below the horizon there is no sky
    grid = (free & (direction[1] < 0)).reshape(SPOKES, rows, cols).mean(axis=0)
    return uniform_filter(grid.astype(np.float32), 3, mode="nearest")


def _ambient_at(scene: Scene, k: int, u: Array, v: Array, normal: Array, tilt: Array) -> Array:
    """Compute the (N, 3) light from the sky and the surroundings."""
    surface, grid = scene.surfaces[k], _openness(scene.surfaces)[k]
    if grid is None:
        sky = 0.5 - 0.35 * normal[1]
    else:
        rows, cols = grid.shape
        (w, h) = surface.size  # type: ignore[attr-defined]
        x, y = np.clip(u / w, 0, 1) * (cols - 1), np.clip(v / h, 0, 1) * (rows - 1)
        i, j = np.minimum(y.astype(int), rows - 2), np.minimum(x.astype(int), cols - 2)
        fy, fx = y - i, x - j
        sky = (grid[i, j] * (1 - fx) + grid[i, j + 1] * fx) * (1 - fy)
        sky = sky + (grid[i + 1, j] * (1 - fx) + grid[i + 1, j + 1] * fx) * fy
    sky = np.clip(sky, 0, 1) * tilt
    return (
        sky.astype(np.float32)[:, None] * SKY_LIGHT
        + (0.35 + 0.65 * (1 - sky)).astype(np.float32)[:, None] * BOUNCE
    )
