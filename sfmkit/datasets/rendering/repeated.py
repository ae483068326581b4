"""Rendered scenes of repeated texture: a tiled floor, a facade, a brick wall and a colonnade.

Every cell of a pattern is a copy of the first one, up to a stain over the whole surface whose
strength is the `variation`: 0 makes the cells indistinguishable. The views stand in three groups
far apart, so that some pairs overlap and others see disjoint parts that look alike.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .materials import mix, tone
from .scenes import Pose, Scene, look
from .surfaces import Cone, Material, Rectangle, Surface
from .textures import BROAD, FINE, GRAIN, linear, noise, ramp

__all__ = ["KINDS", "repeated_scene", "repeated_views"]

Array = np.ndarray

# Offsets of the views along the surface, in multiples of its distance; an image covers 1.09.
_OFFSETS = (0.0, 0.13, 0.3, 1.2, 1.35, 1.5, 2.6, 2.75)
_LENGTH, _DEPTH = 30.0, 12.0  # metres of the surfaces


def _noise(u: Array, v: Array, footprint: Array, period: float) -> Array:
    return noise().sample(u / period, v / period, footprint / period)


def _stained(pattern: Material, variation: float) -> Material:
    """Add stains and grain of amplitude `variation`, which do not repeat, to a pattern."""

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        albedo, slope = pattern(u, v, footprint)
        n = _noise(u, v, footprint, 5.3) + 0.7 * _noise(u + 2.2, v + 0.9, footprint, 1.7)
        return tone(albedo, variation * (0.35 * n[:, FINE] + 0.2 * n[:, GRAIN])), slope

    return material


def _cell(u: Array, v: Array, pitch_u: float, pitch_v: float) -> tuple[Array, Array]:
    """Compute the position within the cell of a lattice, metres."""
    return u - np.floor(u / pitch_u) * pitch_u, v - np.floor(v / pitch_v) * pitch_v


def _tiles(pitch: float) -> Material:
    """Make square tiles with a rosette that is invariant to quarter turns and reflections."""
    ground, ink, joint = linear("#b9ae97"), linear("#3f5673"), linear("#5d564b")

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        a, b = (np.abs(x / pitch - 0.5) for x in _cell(u, v, pitch, pitch))
        a, b = np.minimum(a, b), np.maximum(a, b)
        soft = np.maximum(0.01, footprint / pitch)
        grain = _noise(a, b, footprint / pitch, 0.9)
        r, angle = np.hypot(a, b), np.arctan2(a, b)
        petal = ramp(0.36 * np.cos(1.7 * angle) - r, 0.0, soft) * ramp(r, 0.09, soft)
        corner = 1 - ramp(np.hypot(a - 0.42, b - 0.42), 0.06, soft)
        albedo = mix(tone(ground[None], 0.12 * grain[:, FINE]), ink[None], petal)
        albedo = mix(albedo, linear("#8c4a35")[None], np.maximum(corner, 1 - ramp(r, 0.05, soft)))
        return mix(albedo, joint[None], ramp(b, 0.482, soft)), None

    return material


def _windows(pitch_u: float = 1.7, pitch_v: float = 2.3) -> Material:
    """Make a plastered facade with rows of equal windows."""
    plaster, frame, glass, sill = (linear(c) for c in ("#b9a27c", "#d8d3c6", "#2f3a42", "#8f8674"))

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        a, b = _cell(u, v, pitch_u, pitch_v)
        soft = np.maximum(0.01, footprint)
        x, y = a - pitch_u / 2, b - 1.05
        grain = _noise(a, b, footprint, 1.1)
        wall = tone(plaster[None], 0.08 * grain[:, FINE] + 0.05 * grain[:, GRAIN])
        edge = np.minimum(0.5 - np.abs(x), 0.75 - np.abs(y))
        bars = np.minimum(np.abs(x), np.abs(y + 0.25))
        curtain = 0.6 * ramp(np.sin(38 * x + 2 * grain[:, BROAD]), 0.2, 0.8) * (y < 0.2)
        pane = mix(tone(glass[None], 0.3 * grain[:, FINE]), frame[None], curtain)
        window = mix(frame[None], pane, ramp(edge, 0.07, soft) * ramp(bars, 0.03, soft))
        albedo = mix(wall, window, ramp(edge, 0.0, soft))
        ledge = ramp(0.62 - np.abs(x), 0.0, soft) * ramp(0.05 - np.abs(y - 0.81), 0.0, soft)
        band = 1 - ramp(np.abs(b - 0.06), 0.05, soft)
        return mix(albedo, tone(sill[None], 0.2 * grain[:, GRAIN]), np.maximum(ledge, band)), None

    return material


def _bricks(length: float = 0.52, course: float = 0.24) -> Material:
    """Make equal blocks in a running bond."""
    clay, mortar = linear("#94604d"), linear("#b3a68f")

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        odd = np.floor(v / course) % 2
        a, b = _cell(u + 0.5 * length * odd, v, length, course)
        grain = _noise(a + 0.9 * odd, b, footprint, 0.8)
        edge = np.minimum(np.minimum(a, length - a), np.minimum(b, course - b))
        block = tone(clay[None], 0.3 * grain[:, FINE] + 0.15 * grain[:, GRAIN])
        return mix(mortar[None], block, ramp(edge, 0.012, np.maximum(0.008, footprint))), None

    return material


def _drum(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute the albedo of a fluted column with a ring below its top."""
    n = _noise(u, v, footprint, 1.3)
    flutes = 0.3 * np.cos(24 * u) * (1 - ramp(footprint, 0.05, 0.05))
    albedo = tone(linear("#b5aa94")[None], flutes + 0.22 * n[:, FINE] + 0.1 * n[:, GRAIN])
    ring = 1 - ramp(np.abs(v - 0.35), 0.06, np.maximum(0.01, footprint))
    return tone(albedo, -0.9 * ring), None


def _wall(material: Material, z: float, height: float) -> Rectangle:
    return Rectangle(
        np.array([-_LENGTH / 2, -height, z]),
        np.array([_LENGTH, 0, 0]),
        np.array([0, height, 0]),
        material,
    )


def _ground(material: Material) -> Rectangle:
    return Rectangle(
        np.array([-_LENGTH / 2, 0, _DEPTH]),
        np.array([_LENGTH, 0, 0]),
        np.array([0, 0, -_DEPTH - 1]),
        material,
    )


def _column(x: float, variation: float) -> Cone:
    def shifted(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        n = _noise(u + 0.731 * x, v, footprint, 2.1)
        return tone(_drum(u, v, footprint)[0], variation * 0.5 * n[:, FINE]), None

    return Cone(np.array([x, -4.0, 5.0]), 4.0, 0.26, 0.32, shifted)


def _floor(variation: float) -> tuple[Surface, ...]:
    return (_ground(_stained(_tiles(0.45), variation)),)


def _facade(variation: float) -> tuple[Surface, ...]:
    return (_wall(_stained(_windows(), variation), 8.0, 11.5),)


def _brick_wall(variation: float) -> tuple[Surface, ...]:
    return (_wall(_stained(_bricks(), variation), 4.0, 7.2),)


def _colonnade(variation: float) -> tuple[Surface, ...]:
    columns = (_column(x, variation) for x in np.arange(-13.5, 13.6, 1.5))
    back = _wall(_stained(_bricks(1.5, 0.5), variation), 7.5, 5.0)
    return (_ground(_stained(_tiles(0.75), variation)), back, *columns)


# Surfaces, distance of the cameras from what they see, and whether they look down at a floor.
KINDS: dict[str, tuple[Callable[[float], tuple[Surface, ...]], float, bool]] = {
    "tiles": (_floor, 3.4, True),
    "windows": (_facade, 8.0, False),
    "bricks": (_brick_wall, 4.0, False),
    "columns": (_colonnade, 5.5, False),
}


def repeated_views(kind: str) -> tuple[Pose, ...]:
    """Return the cameras of a scene: three groups, two of which overlap by at most a third."""
    _, distance, down = KINDS[kind]
    poses = []
    for k, offset in enumerate(_OFFSETS):
        x = distance * (offset - _OFFSETS[-1] / 2)
        lift, near, aim, roll = 0.12 * np.sin(2.1 * k), 0.06 * np.cos(1.7 * k), 0.3 * (k % 3 - 1), k
        if down:
            eye, target = (x, -2.1 - lift, near), (x + aim, 0.0, 2.5)
        else:
            eye = (x, -2.0 - lift, 0.2 + distance * near)
            target = (x + aim, -2.2, max(distance, 5.0))
        poses.append(look(eye, target, 1.5 * np.sin(1.3 * roll)))
    return tuple(poses)


def repeated_scene(kind: str, variation: float) -> Scene:
    """Build a scene of repeated texture, with the first two cameras of :func:`repeated_views`.

    Args:
        kind: Name in :data:`KINDS`.
        variation: Amplitude of the stains that make the cells differ; 0 for exact copies.
    """
    surfaces, _, _ = KINDS[kind]
    first, second, *_ = repeated_views(kind)
    return Scene(f"{kind}-{variation:g}", surfaces(variation), first, second)
