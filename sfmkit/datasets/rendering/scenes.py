"""Scenes: surfaces, a sun, a sky, and two cameras.

The axes of the world are x right, y down and z forward; units are metres. The ground is y = 0, so
points above it have negative y.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np

from . import materials as m
from .surfaces import (
    Cap,
    Cone,
    Hole,
    Material,
    Rectangle,
    Surface,
    Triple,
    blocked,
    box,
    dot,
    unit,
)

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Pose:
    """The pose of a camera: ``x_cam = R (X - centre)``."""

    R: Array
    centre: Array


def look(
    eye: tuple[float, float, float], target: tuple[float, float, float], roll_deg: float = 0.0
) -> Pose:
    """Compute the pose of a camera at `eye` that looks at `target`, rolled by `roll_deg`."""
    centre = np.array(eye, dtype=np.float64)
    forward = unit(np.array(target) - centre)
    right = unit(np.cross([0.0, 1.0, 0.0], forward))
    down = np.cross(forward, right)
    c, s = np.cos(np.deg2rad(roll_deg)), np.sin(np.deg2rad(roll_deg))
    return Pose(np.stack([c * right + s * down, c * down - s * right, forward]), centre)


@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces, light and two cameras.

    Attributes:
        surfaces: Surfaces; a ray that hits none of them shows the sky.
        pose1, pose2: Poses of the two cameras.
        focal: Focal length over the longer side of the image.
        sun: (3,) unit vector towards the sun.
    """

    name: str
    surfaces: tuple[Surface, ...]
    pose1: Pose
    pose2: Pose
    focal: float = 0.92
    sun: Array = field(default_factory=lambda: unit(np.array([-0.50, -0.72, -0.75])))

    def K(self, size_wh: tuple[int, int]) -> Array:
        """Return the (3, 3) intrinsics for an image of `size_wh`.

        The pixels are not exactly square, and the principal point is not exactly central.
        """
        w, h = size_wh
        f = self.focal * max(w, h)
        return np.array([[f, 0, 0.506 * w - 0.5], [0, 1.002 * f, 0.496 * h - 0.5], [0, 0, 1]])

    def cast(
        self, origin: Array, direction: Array, steps: int, only: tuple[int, ...] | None = None
    ):
        """Compute the first hits of rays (3, N): ``s``, the index of the surface, and (u, v).

        For sky, ``s`` is inf and the index -1.
        """
        n = max(origin.shape[1], direction.shape[1])
        s, index = np.full(n, np.inf), np.full(n, -1)
        u, v = np.zeros(n), np.zeros(n)
        for k in range(len(self.surfaces)) if only is None else only:
            sk, uk, vk = self.surfaces[k].intersect(origin, direction, steps)
            (nearer,) = np.nonzero(sk < s)
            s[nearer], u[nearer], v[nearer], index[nearer] = sk[nearer], uk[nearer], vk[nearer], k
        return s, index, u, v

    @cached_property
    def _silhouettes(self) -> tuple[Array, Array]:
        """Two axes (2, 3) orthogonal to the sun, and the extents (2, 2) of every surface on them.

        An extent is (low, high) per axis.
        """
        across = np.stack([unit(np.cross(self.sun, [0.0, 1, 0])), np.zeros(3)])
        across[1] = np.cross(self.sun, across[0])
        corners = [across @ surface.corners().T for surface in self.surfaces]
        return across, np.array([[c.min(axis=1), c.max(axis=1)] for c in corners])

    def shaded(self, point: Array) -> Array:
        """Return (N,) whether points (3, N) are in shadow; reliefs count as flat."""
        across, extents = self._silhouettes
        x, y = dot(across[0], point), dot(across[1], point)
        hit = np.zeros(point.shape[1], dtype=bool)
        if not len(hit):
            return hit
        left, right, top, bottom = x.min(), x.max(), y.min(), y.max()
        for surface, ((x0, y0), (x1, y1)) in zip(self.surfaces, extents):
            if x1 < left or x0 > right or y1 < top or y0 > bottom:
                continue
            (under,) = np.nonzero(~hit & (x > x0) & (x < x1) & (y > y0) & (y < y1))
            if len(under):
                hit[under] = blocked([surface], point[:, under], self.sun[:, None])
        return hit


def _brick_wall(
    x0: float, x1: float, z: float, top: float, material: Material, holes: tuple[Hole, ...]
) -> Rectangle:
    """Make a wall that faces the viewer, with bricks in relief."""
    across, down = np.array([x1 - x0, 0, 0]), np.array([0, -top, 0])
    corner = np.array([x0, top, z])
    return Rectangle(
        corner, across, down, material, holes, m.brick_height, m.BRICK_THICKNESS, m.BRICK_STEEPNESS
    )


def _slab(corner: Triple, size: Triple, material: Material) -> list[Rectangle]:
    return box(corner, size, 0, lambda w, h: material)


def _recess(
    x0: float, y0: float, x1: float, y1: float, z: float, deep: float, back, jamb
) -> list[Surface]:
    """Make the inside of an opening in a wall at `z`: two jambs, lintel, sill and back."""
    w, h, zb = x1 - x0, y1 - y0, z + deep
    return [
        Rectangle(np.array([x0, y0, zb]), np.array([w, 0, 0]), np.array([0, h, 0]), back),
        Rectangle(np.array([x0, y0, z]), np.array([0, 0, deep]), np.array([0, h, 0]), jamb),
        Rectangle(np.array([x1, y0, zb]), np.array([0, 0, -deep]), np.array([0, h, 0]), jamb),
        Rectangle(np.array([x0, y0, z]), np.array([w, 0, 0]), np.array([0, 0, deep]), jamb),
        Rectangle(np.array([x0, y1, zb]), np.array([w, 0, 0]), np.array([0, 0, -deep]), jamb),
    ]


def _dish(
    bottom: tuple[float, float, float], axis: tuple[float, float, float], radius: float, rim: float
) -> Cap:
    return Cap(np.array(bottom), unit(np.array(axis)), radius, rim, m.ceramic(rim))


@cache
def _courtyard() -> tuple[Surface, ...]:
    z, top = 7.0, -3.9
    pale = m.stone((0.55, 0.3))
    door, window = (1.35, -2.25, 2.4, 0.0), (-2.05, -2.85, -0.95, -1.45)
    x0, x1 = -3.1, 3.5
    holes = tuple((a - x0, b - top, c - x0, d - top) for a, b, c, d in (door, window))
    brickwork = m.with_decals(m.brick, ("graffiti", 1, (2.35, 1.15, 4.2, 2.7)))
    side = m.with_decals(
        m.plaster("#cda869"),
        ("graffiti", 2, (2.3, 0.5, 4.4, 2.2)),
        ("poster", 3, (0.6, 0.7, 1.4, 1.8)),
        ("poster", 4, (4.75, 0.75, 5.45, 1.65)),
    )
    right = m.with_decals(
        m.plaster("#b9573f", 1.3),
        ("poster", 7, (0.6, 1.3, 1.3, 2.3)),
        ("poster", 8, (1.45, 1.4, 2.05, 2.25)),
    )
    surfaces: list[Surface] = [
        Rectangle(
            np.array([-5.0, 0, 8.0]), np.array([10.0, 0, 0]), np.array([0, 0, -9.0]), m.cobbles
        ),
        _brick_wall(x0, x1, z, top, brickwork, holes),
        Rectangle(np.array([x0, -2.55, 1.0]), np.array([0, 0, 6.0]), np.array([0, 2.55, 0]), side),
        Rectangle(np.array([x1, -3.3, z]), np.array([0, 0, -3.2]), np.array([0, 3.3, 0]), right),
        *_recess(*door, z, 0.35, m.planks(0.16, "#6b4a30", nails=0.45), pale),
        *_recess(*window, z, 0.12, m.louvres(1.1, 1.4), pale),
    ]
    # stone around the openings, at the foot, under the roof and on the wall
    for a, b, c, d in (door, window):
        surfaces += _slab((a - 0.14, b, z - 0.06), (0.14, d - b, 0.2), m.stone((0.4, 0.37)))
        surfaces += _slab((c, b, z - 0.06), (0.14, d - b, 0.2), m.stone((0.4, 0.37)))
        surfaces += _slab(
            (a - 0.24, b - 0.2, z - 0.09), (c - a + 0.48, 0.2, 0.2), m.stone((1.7, 0.3))
        )
    surfaces += _slab((window[0] - 0.2, window[3], z - 0.16), (1.5, 0.1, 0.3), m.stone((1.9, 0.3)))
    for a, b in ((x0, door[0] - 0.14), (door[2] + 0.14, x1)):
        surfaces += _slab((a, -0.42, z - 0.07), (b - a, 0.42, 0.2), m.stone((0.7, 0.21), "#a39a86"))
    surfaces += _slab(
        (x0, top - 0.25, z - 0.3), (x1 - x0, 0.25, 0.5), m.stone((0.9, 0.25), "#b9ae98")
    )
    surfaces += _slab((x0 - 0.2, -2.67, 1.0), (0.28, 0.14, 6.0), m.stone((0.14, 0.8), "#b9ae98"))
    # objects
    surfaces += box((-0.55, -0.85, 5.15), (0.95, 0.85, 0.8), 24, m.crate())
    surfaces += box((-0.42, -1.33, 5.5), (0.52, 0.48, 0.46), 6, m.crate("#8c6a44", 12))
    surfaces += box((2.3, -0.6, 5.3), (0.7, 0.6, 0.7), -32, m.crate("#97713f", 13))
    surfaces += [
        _dish((-1.72, -0.78, 6.35), (0.12, -0.32, -1.0), 1.15, 0.78),
        Cone(np.array([1.2, -0.62, 5.6]), 0.62, 0.3, 0.2, m.terracotta),
        Cone(np.array([2.78, -1.0, 5.75]), 0.4, 0.2, 0.13, m.terracotta),
        Cap(np.array([1.2, -0.56, 5.6]), np.array([0.0, 1, 0]), 1.5, 0.285, m.soil),
        Cap(np.array([2.78, -0.96, 5.75]), np.array([0.0, 1, 0]), 1.5, 0.19, m.soil),
        Cone(np.array([-2.35, -2.6, 4.6]), 2.6, 0.17, 0.21, m.stone((0.66, 0.65), "#b8ab92")),
    ]
    surfaces += _slab((-2.65, -2.85, 4.3), (0.6, 0.25, 0.6), m.stone((0.7, 0.3), "#b8ab92"))
    surfaces += _slab((-2.62, -0.2, 4.33), (0.54, 0.2, 0.54), m.stone((0.7, 0.3), "#b8ab92"))
    return tuple(surfaces)


def _plane() -> tuple[Surface, ...]:
    painted = m.with_decals(
        lambda u, v, f: m.mural(u - 6, v - 5, f),
        ("poster", 3, (4.3, 3.2, 5.2, 4.4)),
        ("poster", 4, (6.6, 5.0, 7.5, 6.2)),
        ("graffiti", 2, (4.4, 4.5, 6.7, 6.3)),
        ("graffiti", 1, (6.4, 3.1, 8.4, 4.8)),
    )
    return (
        Rectangle(np.array([-6.0, -5, 6]), np.array([12.0, 0, 0]), np.array([0, 10.0, 0]), painted),
    )


def _dish_alone() -> tuple[Surface, ...]:
    ground = Rectangle(
        np.array([-6.0, 0, 10]), np.array([12.0, 0, 0]), np.array([0, 0, -10.0]), m.cobbles
    )
    wall = Rectangle(
        np.array([-5, -4, 4.2]), np.array([10.0, 0, 0]), np.array([0, 4.0, 0]), m.plaster("#b8a27a")
    )
    return (ground, wall, _dish((0.1, -0.98, 3.6), (0.1, -0.28, -1.0), 1.3, 1.0))


FIRST = look((-0.75, -1.6, 0.3), (-0.15, -1.45, 7.0))

#: Named scenes of :func:`sfmkit.datasets.synthetic.render`.
SCENES: dict[str, Callable[[], Scene]] = {
    "courtyard": lambda: Scene(
        "courtyard", _courtyard(), FIRST, look((0.6, -1.72, 0.45), (0.1, -1.4, 7.0), 1.5)
    ),
    "wide": lambda: Scene(
        "wide", _courtyard(), FIRST, look((2.6, -1.9, 1.1), (-0.2, -1.4, 7.0), -3)
    ),
    "forward": lambda: Scene(
        "forward", _courtyard(), FIRST, look((-0.6, -1.58, 1.7), (-0.1, -1.42, 7.0), -1)
    ),
    "pure-rotation": lambda: Scene(
        "pure-rotation", _courtyard(), FIRST, look((-0.75, -1.6, 0.3), (0.8, -1.2, 7.0), 2)
    ),
    "no-overlap": lambda: Scene(
        "no-overlap", _courtyard(), FIRST, look((0.3, -1.6, 2.6), (-3.1, -1.5, 2.2))
    ),
    "plane": lambda: Scene(
        "plane",
        _plane(),
        look((-0.6, 0.1, 0.2), (0.1, -0.1, 6)),
        look((1.5, -0.5, 0.9), (0.15, 0.1, 6), 4),
    ),
    "dish": lambda: Scene(
        "dish",
        _dish_alone(),
        look((-0.7, -1.5, 0.3), (0, -1.0, 4)),
        look((0.4, -1.7, 0.4), (0, -0.95, 4), 2),
    ),
}
