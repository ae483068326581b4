"""Surfaces with ray intersection: rectangles (flat or with relief), spherical caps and cones.

Rays are ``origin + s * direction`` with arrays of shape (3, N) or (3, 1). The y axis of the world
points down; units are metres. An intersection is the smallest ``s > NEAR`` (inf for none) and the
position (u, v) on the surface, metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

Array = np.ndarray
#: (u, v, footprint) in metres -> linear albedo (N, 3), and the slope (N, 2) of small bumps.
Material = Callable[[Array, Array, Array], tuple[Array, Array | None]]
#: (u, v) in metres -> height over the plane in metres.
Height = Callable[[Array, Array], Array]
Triple = tuple[float, float, float]
Hole = tuple[float, float, float, float]

NEAR = 1e-6


class Surface(Protocol):
    @property
    def material(self) -> Material: ...

    def intersect(self, origin: Array, direction: Array, steps: int) -> tuple[Array, Array, Array]:
        """Compute ``s``, ``u`` and ``v`` of the first hit.

        A relief is intersected in at most `steps` steps; with 0 it is treated as flat.
        """

    def frame(
        self, point: Array, u: Array, v: Array, footprint: Array
    ) -> tuple[Array, Array, Array]:
        """Compute the normal (3, N), and the slopes (N,) of the relief along u and v."""

    def corners(self) -> Array:
        """Return (M, 3) points whose convex hull contains the surface."""


def unit(a: Array) -> Array:
    return a / np.linalg.norm(a, axis=0)


def dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangle with holes, visible from the side of its normal ``cross(along_v, along_u)``.

    Attributes:
        corner: (3,) position of u = v = 0.
        along_u, along_v: (3,) orthogonal edges; their lengths are the size.
        relief: Height of the surface above the rectangle, between 0 and `thickness`; its slope is
            at most `steepness`.
    """

    corner: Array
    along_u: Array
    along_v: Array
    material: Material
    holes: tuple[Hole, ...] = ()
    relief: Height | None = None
    thickness: float = 0.0
    steepness: float = 0.0

    @cached_property
    def size(self) -> tuple[float, float]:
        return float(np.linalg.norm(self.along_u)), float(np.linalg.norm(self.along_v))

    @cached_property
    def axes(self) -> Array:
        """The (3, 3) matrix with rows unit u, unit v and unit normal."""
        u, v = unit(self.along_u), unit(self.along_v)
        return np.stack([u, v, np.cross(v, u)])

    def corners(self) -> Array:
        a, b = self.along_u, self.along_v
        base = self.corner + np.stack([0 * a, a, b, a + b])
        return np.concatenate([base, base + self.thickness * self.axes[2]])

    def intersect(self, origin: Array, direction: Array, steps: int) -> tuple[Array, Array, Array]:
        eu, ev, n = self.axes
        o = origin - self.corner[:, None]
        slope = dot(n, direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(slope < 0, (self.thickness * (steps > 0) - dot(n, o)) / slope, np.inf)
            s[~(s > NEAR)] = np.inf
            u, v = dot(eu, o) + s * dot(eu, direction), dot(ev, o) + s * dot(ev, direction)
        if self.relief is not None and steps > 0:
            (hit,) = np.nonzero(np.isfinite(s) & self._near(u, v))
            start = s[hit]
            s[:] = np.inf
            ray = np.stack(
                [
                    np.broadcast_to(dot(e, d), s.shape)[hit]
                    for d in (o, direction)
                    for e in (eu, ev, n)
                ]
            )
            s[hit] = self._descend(ray, start, steps)
            u[hit], v[hit] = ray[0] + s[hit] * ray[3], ray[1] + s[hit] * ray[4]
        s[~self._inside(u, v)] = np.inf
        return s, u, v

    def _near(self, u: Array, v: Array) -> Array:
        w, h = self.size
        m = 4 * self.thickness
        return (u >= -m) & (u <= w + m) & (v >= -m) & (v <= h + m)

    def _inside(self, u: Array, v: Array) -> Array:
        w, h = self.size
        inside = (u >= 0) & (u <= w) & (v >= 0) & (v <= h)
        for u0, v0, u1, v1 in self.holes:
            inside &= ~((u > u0) & (u < u1) & (v > v0) & (v < v1))
        return inside

    def _descend(self, ray: Array, s: Array, steps: int) -> Array:
        """Intersect rays with the relief by sphere tracing, starting above it at `s`.

        Rays are (6, N): origin and direction in u, v, n. A step of the height above the relief over
        the fastest rate at which this height can shrink never passes through the relief.

        Source: Hart, "Sphere tracing", The Visual Computer 12 (1996).
        """
        assert self.relief is not None
        s = s.copy()
        rate = -ray[5] + self.steepness * np.hypot(ray[3], ray[4])
        going = np.arange(len(s))
        for _ in range(steps):
            u, v, n = ray[:3, going] + s[going] * ray[3:, going]
            gap = n - self.relief(u, v)
            s[going] += gap / rate[going]
            going = going[gap > TOUCH]
            if not len(going):
                break
        return s

    def frame(
        self, point: Array, u: Array, v: Array, footprint: Array
    ) -> tuple[Array, Array, Array]:
        normal = np.broadcast_to(self.axes[2][:, None], point.shape)
        if self.relief is None:
            return normal, np.zeros(len(u)), np.zeros(len(u))
        e = np.maximum(0.0015, 0.5 * footprint)
        return (
            normal,
            (self.relief(u + e, v) - self.relief(u - e, v)) / (2 * e),
            (self.relief(u, v + e) - self.relief(u, v - e)) / (2 * e),
        )


TOUCH = 1e-12  # metres above a relief that count as a hit


def _first(candidates: list[tuple[Array, Array]]) -> Array:
    """Return the smallest admissible s of several (s, admissible), inf for none."""
    s = np.full_like(candidates[0][0], np.inf)
    for value, good in candidates:
        np.minimum(s, np.where(good & (value > NEAR), value, np.inf), out=s)
    return s


@dataclass(frozen=True, eq=False)
class Cap:
    """A dish: the part of a sphere within `rim` metres of an axis, visible from both sides.

    The position (u, v) is in the plane of the rim.

    Attributes:
        bottom: (3,) deepest point of the dish.
        axis: (3,) unit vector from the bottom to the open side.
        radius: Radius of the sphere, metres.
        rim: Radius of the rim, metres.
    """

    bottom: Array
    axis: Array
    radius: float
    rim: float
    material: Material

    @property
    def centre(self) -> Array:
        return self.bottom + self.radius * self.axis

    @property
    def depth(self) -> float:
        return self.radius - float(np.sqrt(self.radius**2 - self.rim**2))

    def _plane(self) -> tuple[Array, Array]:
        eu = unit(np.cross(self.axis, [0.0, 1.0, 0.03]))
        return eu, np.cross(self.axis, eu)

    def corners(self) -> Array:
        eu, ev = self._plane()
        square = (
            self.rim * np.array([[i, j] for i in (-1, 1) for j in (-1, 1)]) @ np.stack([eu, ev])
        )
        return self.bottom + np.concatenate([square, square + self.depth * self.axis])

    def intersect(self, origin: Array, direction: Array, steps: int) -> tuple[Array, Array, Array]:
        o = origin - self.centre[:, None]
        a, b, c = dot(direction, direction), dot(o, direction), dot(o, o) - self.radius**2
        edge = self.depth - self.radius
        with np.errstate(invalid="ignore"):
            root = np.sqrt(b * b - a * c)
            roots = ((-b - root) / a, (-b + root) / a)
            s = _first(
                [(r, dot(o, self.axis) + r * dot(direction, self.axis) <= edge) for r in roots]
            )
            eu, ev = self._plane()
            return s, dot(o, eu) + s * dot(direction, eu), dot(o, ev) + s * dot(direction, ev)

    def frame(
        self, point: Array, u: Array, v: Array, footprint: Array
    ) -> tuple[Array, Array, Array]:
        return (self.centre[:, None] - point) / self.radius, np.zeros(len(u)), np.zeros(len(u))


@dataclass(frozen=True, eq=False)
class Cone:
    """The lateral surface of an upright frustum; u runs around it, v down from its top.

    Attributes:
        top: (3,) centre of the upper circle.
        height: Height, metres.
        radius_top, radius_bottom: Radii of the two circles, metres.
    """

    top: Array
    height: float
    radius_top: float
    radius_bottom: float
    material: Material

    def corners(self) -> Array:
        r = max(self.radius_top, self.radius_bottom)
        return self.top + np.array(
            [[i * r, k * self.height, j * r] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)]
        )

    def intersect(self, origin: Array, direction: Array, steps: int) -> tuple[Array, Array, Array]:
        # x^2 + z^2 = (r + k y)^2 with y measured down from the top
        k = (self.radius_bottom - self.radius_top) / self.height
        (x, y, z), (dx, dy, dz) = origin - self.top[:, None], direction
        r = self.radius_top + k * y
        a = dx * dx + dz * dz - (k * dy) ** 2
        b = x * dx + z * dz - r * k * dy
        c = x * x + z * z - r * r
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            roots = ((-b - root) / a, (-b + root) / a)
            s = _first([(q, (y + q * dy >= 0) & (y + q * dy <= self.height)) for q in roots])
            u = 0.5 * (self.radius_top + self.radius_bottom) * np.arctan2(x + s * dx, -(z + s * dz))
            return s, u, y + s * dy

    def frame(
        self, point: Array, u: Array, v: Array, footprint: Array
    ) -> tuple[Array, Array, Array]:
        k = (self.radius_bottom - self.radius_top) / self.height
        x, _, z = point - self.top[:, None]
        normal = np.stack([x, -k * np.hypot(x, z), z])
        return unit(normal), np.zeros(len(u)), np.zeros(len(u))


def blocked(surfaces: Iterable[Surface], origin: Array, direction: Array) -> Array:
    """Return (N,) whether rays (3, N) hit any surface; reliefs count as flat."""
    hit = np.zeros(max(origin.shape[1], direction.shape[1]), dtype=bool)
    for surface in surfaces:
        hit |= np.isfinite(surface.intersect(origin, direction, 0)[0])
    return hit


def box(
    corner: Triple, size: Triple, yaw_deg: float, material: Callable[[float, float], Material]
) -> list[Rectangle]:
    """Make the six sides of a box of `size` (x, y down, z), with upper front left corner `corner`.

    `material(width, height)` returns the material of a side of this size.
    """
    w, h, d = size
    a = np.deg2rad(yaw_deg)
    ex, ey, ez = (
        np.array([np.cos(a), 0, np.sin(a)]),
        np.array([0, 1.0, 0]),
        np.array([-np.sin(a), 0, np.cos(a)]),
    )
    c = np.asarray(corner, dtype=float)
    return [
        Rectangle(c, w * ex, h * ey, material(w, h)),
        Rectangle(c + w * ex, d * ez, h * ey, material(d, h)),
        Rectangle(c + w * ex + d * ez, -w * ex, h * ey, material(w, h)),
        Rectangle(c + d * ez, -d * ez, h * ey, material(d, h)),
        Rectangle(c + d * ez, w * ex, -d * ez, material(w, d)),
        Rectangle(c + h * ey, w * ex, d * ez, material(w, d)),
    ]
