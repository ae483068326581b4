"""Materials of the rendered scenes: brick, plaster, stone, wood, cobbles, glazed ceramic.

A material maps positions (u, v) in metres and the footprint of a pixel to an albedo (N, 3) in
linear light and, if it is bumpy, to the slope (N, 2) of its bumps. Steps and noise are averaged
over the footprint to avoid aliasing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .surfaces import Material
from .textures import BROAD, FINE, GRAIN, RELIEF, decal, dice, linear, noise, ramp

Array = np.ndarray


def mix(a: Array, b: Array, weight: Array) -> Array:
    """Interpolate from `a` at `weight` (N,) 0 to `b` at weight 1."""
    return a + weight.astype(np.float32)[:, None] * (b - a)


def tone(colour: Array, change: Array) -> Array:
    """Multiply `colour` by the exponential of `change` (N,)."""
    return colour * np.exp(change).astype(np.float32)[:, None]


def _noise(u: Array, v: Array, footprint: Array, period: float) -> Array:
    return noise().sample(u / period, v / period, footprint / period)


# ---- masonry ----

COURSE, LENGTH, MORTAR = 0.085, 0.26, 0.012
BRICK_THICKNESS, BRICK_STEEPNESS = (
    0.028,
    0.028 / 0.012,
)  # metres; greatest height and slope of the relief
CLAY = np.stack(
    [linear(c) for c in ("#75463a", "#946052", "#a87460", "#86564b", "#b58c74", "#644540")]
)
MORTAR_COLOUR = linear("#b3a68f")


def brick_cells(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Compute row and column of the brick at (u, v), and the distance to the joint, metres.

    The bricks are laid in a running bond.
    """
    row = np.floor(v / COURSE)
    along = u / LENGTH + 0.5 * (row % 2)
    column = np.floor(along)
    du, dv = (along - column) * LENGTH, v - row * COURSE
    return row, column, np.minimum(np.minimum(du, LENGTH - du), np.minimum(dv, COURSE - dv))


def brick_height(u: Array, v: Array) -> Array:
    """Compute the relief of a brick wall, metres; bricks protrude by different amounts."""
    row, column, edge = brick_cells(u, v)
    r = dice(row, column)
    proud = 0.007 + 0.008 * r[:, 1] + 0.013 * (r[:, 2] > 0.93)
    return proud * ramp(edge, 0.007, 0.012)


def brick(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute weathered bricks in light mortar, with soot, efflorescence and lime wash."""
    row, column, edge = brick_cells(u, v)
    r = dice(row, column)
    n = _noise(u + 7 * r[:, 0], v + 7 * r[:, 3], footprint, 1.3)
    patch, streak = _noise(u, v, footprint, 5.1), _noise(u, 0.13 * v, footprint, 1.9)
    clay = CLAY.take((r[:, 0] * len(CLAY)).astype(int), axis=0)
    clay = tone(
        clay, 0.5 * (r[:, 3] - 0.5) + 0.18 * n[:, FINE] + 0.08 * n[:, GRAIN] + 0.09 * n[:, RELIEF]
    )
    clay = mix(
        clay, linear("#38302d")[None], 0.85 * ramp(n[:, FINE] - 0.3 * n[:, GRAIN], 1.7, 0.3)
    )  # burnt spots
    clay = mix(
        clay, linear("#d8cdbd")[None], 0.4 * ramp(n[:, BROAD] + 0.2 * n[:, GRAIN], 1.8, 1.2)
    )  # salts
    fine = _noise(u, v, footprint, 0.9)
    mortar = tone(MORTAR_COLOUR[None], 0.2 * fine[:, FINE] + 0.1 * fine[:, GRAIN] - 0.15)
    wander = 0.0018 * fine[:, GRAIN] + 0.0012 * fine[:, FINE]
    albedo = mix(mortar, clay, ramp(edge + wander, MORTAR / 2, np.maximum(0.003, footprint)))
    lime = tone(linear("#ddd3bf")[None], 0.1 * fine[:, FINE] + 0.06 * fine[:, GRAIN])
    lime_at = patch[:, BROAD] + 0.45 * patch[:, FINE] + 0.16 * fine[:, FINE] + 0.1 * (row % 2)
    albedo = mix(albedo, lime, 0.8 * ramp(lime_at, 1.75, 0.16))
    albedo = tone(albedo, 0.16 * patch[:, BROAD] - 0.35 * ramp(streak[:, FINE], 1.0, 1.5))
    return albedo, None


def plaster(colour: str, wear: float = 1.0) -> Material:
    """Make painted plaster with stains, hair cracks, and chips that expose the grey ground coat."""
    paint = linear(colour)

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        n, m = _noise(u, v, footprint, 1.7), _noise(u + 3.3, v + 1.1, footprint, 6.3)
        run = _noise(u + 0.7, 0.11 * v, footprint, 2.3)
        albedo = tone(
            paint[None],
            0.08 * n[:, FINE] + 0.05 * n[:, GRAIN] + 0.07 * n[:, RELIEF] + 0.12 * m[:, BROAD],
        )
        albedo = mix(
            albedo,
            linear("#5d5344")[None],
            wear * 0.5 * ramp(run[:, FINE] + 0.3 * n[:, FINE], 1.3, 1.8),
        )
        chip = m[:, FINE] + 0.35 * n[:, FINE]
        ground = tone(linear("#9b9184")[None], 0.3 * n[:, GRAIN] + 0.2 * n[:, FINE])
        albedo = mix(albedo, linear("#3b352d")[None], 0.5 * ramp(chip, 2.02 - 0.25 * wear, 0.05))
        albedo = mix(albedo, ground, ramp(chip, 2.1 - 0.25 * wear, 0.05))
        width = np.maximum(0.012, 1.2 * footprint)
        crack = np.abs(m[:, BROAD] - 0.4 + 0.05 * n[:, FINE])
        return tone(
            albedo, -1.1 * wear * (1 - ramp(crack, 0.02, width)) * (n[:, BROAD] > -0.3)
        ), None

    return material


def stone(block: tuple[float, float], colour: str = "#b5a98f") -> Material:
    """Make ashlar: pitted blocks of `block` metres with fine dark joints."""
    base, (bu, bv) = linear(colour), block

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        row = np.floor(v / bv)
        along = u / bu + 0.5 * (row % 2)
        column = np.floor(along)
        du, dv = (along - column) * bu, v - row * bv
        edge = np.minimum(np.minimum(du, bu - du), np.minimum(dv, bv - dv))
        r = dice(row, column, 3)
        n = _noise(u + 5 * r[:, 0], v + 5 * r[:, 1], footprint, 1.1)
        albedo = tone(
            base[None],
            0.35 * (r[:, 2] - 0.5) + 0.2 * n[:, FINE] + 0.1 * n[:, GRAIN] + 0.14 * n[:, RELIEF],
        )
        albedo = mix(
            albedo, linear("#7b7f5c")[None], 0.45 * ramp(n[:, BROAD] + 0.4 * n[:, FINE], 1.2, 0.8)
        )  # lichen
        albedo = tone(albedo, -1.2 * ramp(n[:, GRAIN] + 0.6 * n[:, FINE], 2.4, 0.5))  # pits
        joint = 1 - ramp(edge + 0.0015 * n[:, GRAIN], 0.004, np.maximum(0.004, footprint))
        return mix(albedo, linear("#5b5245")[None], 0.8 * joint), None

    return material


def cobbles(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute cobblestones in sand: domed Voronoi cells of a jittered lattice (Worley 1996)."""
    pitch = 0.17
    i, j = np.floor(u / pitch), np.floor(v / pitch)
    first = np.full(len(u), np.inf)
    second, centre, cell = first.copy(), np.zeros((2, len(u))), np.zeros((2, len(u)))
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            r = dice(i + di, j + dj, 1)
            x, y = (
                (i + di + 0.15 + 0.7 * r[:, 0]) * pitch - u,
                (j + dj + 0.15 + 0.7 * r[:, 1]) * pitch - v,
            )
            d = x * x + y * y
            nearer = d < first
            second = np.where(nearer, first, np.minimum(second, d))
            first = np.where(nearer, d, first)
            for store, values in ((centre, (x, y)), (cell, (i + di, j + dj))):
                store[0][nearer], store[1][nearer] = values[0][nearer], values[1][nearer]
    gap = np.sqrt(second) - np.sqrt(first)
    r = dice(cell[0], cell[1], 2)
    n = _noise(u + 3 * r[:, 0], v + 3 * r[:, 1], footprint, 0.9)
    broad = _noise(u, v, footprint, 4.3)
    warm, cold = linear("#938372"), linear("#6c6f74")
    rock = tone(
        mix(warm[None], cold[None], r[:, 2]),
        0.7 * (r[:, 3] - 0.5) + 0.22 * n[:, FINE] + 0.09 * n[:, GRAIN],
    )
    rock = mix(rock, linear("#cfc4b4")[None], 0.5 * ramp(n[:, FINE], 1.6, 0.4))  # quartz
    sand = tone(linear("#6d5b45")[None], 0.3 * n[:, GRAIN] + 0.2 * broad[:, FINE])
    moss = tone(linear("#4b5a2c")[None], 0.4 * n[:, GRAIN])
    sand = mix(sand, moss, ramp(broad[:, BROAD] + 0.3 * n[:, FINE], 0.7, 0.6))
    on = ramp(gap + 0.004 * n[:, FINE], 0.022, np.maximum(0.012, footprint))
    albedo = tone(mix(sand, rock, on), 0.12 * broad[:, FINE] - 0.5 * (1 - ramp(gap, 0.025, 0.05)))
    return albedo, (centre * (4.5 * on * (1 - 0.5 * ramp(footprint, 0.04, 0.04)))).T


# ---- wood ----


def _grain(u: Array, v: Array, footprint: Array, base: Array, salt: Array) -> Array:
    """Compute the grain of boards along u: fibres, growth rings and knots."""
    n = _noise(0.06 * u + 9 * salt[:, 0], v + 9 * salt[:, 1], footprint, 0.7)
    ring = np.sin(60 * v + 2.2 * n[:, BROAD] + 3 * u + 40 * salt[:, 2]) * (
        1 - ramp(footprint, 0.03, 0.03)
    )
    wood = tone(
        base[None], 0.5 * (salt[:, 3] - 0.5) + 0.2 * n[:, FINE] + 0.16 * n[:, GRAIN] + 0.1 * ring
    )
    return mix(wood, 0.25 * base[None], 0.8 * ramp(n[:, FINE], 2.0, 0.3))


def planks(
    width: float, colour: str, length: float = 1e3, salt: int = 5, nails: float = 0.0
) -> Material:
    """Make boards of `width` along v, with dark gaps and a nail head every `nails` metres."""
    base = linear(colour)

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        board = np.floor(u / width)
        across = u - board * width
        r = dice(board, np.floor(v / length + 0.37 * board), salt)
        wood = _grain(v, across, footprint, base, r)
        edge = np.minimum(across, width - across)
        wood = tone(wood, -2.0 * (1 - ramp(edge, 0.004, np.maximum(0.005, footprint))))
        if nails:
            dv = v - (np.floor(v / nails) + 0.5) * nails
            head = np.hypot(np.abs(across - width / 2) - 0.25 * width, dv)
            wood = mix(
                wood, linear("#241f1c")[None], 1 - ramp(head, 0.009, np.maximum(0.005, footprint))
            )
        return wood, None

    return material


def crate(colour: str = "#a07a4c", salt: int = 11) -> Callable[[float, float], Material]:
    """Make the sides of a wooden crate: nailed boards in a frame, with stencilled marks."""
    base = linear(colour)

    def side(w: float, h: float) -> Material:
        seed = salt + int(100 * w + 10 * h)

        def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
            soft = np.maximum(0.004, footprint)
            frame, n_boards = 0.09, 6
            upright = np.minimum(u, w - u) < frame
            rail = (np.minimum(v, h - v) < frame) & ~upright
            pitch = h / n_boards
            board = np.where(
                upright, 50 + (u > w / 2), np.where(rail, 60 + (v > h / 2), np.floor(v / pitch))
            )
            along, across = (
                np.where(upright, v, u),
                np.where(upright, u % (w / 2), np.where(rail, v % (h / 2), v % pitch)),
            )
            wood = _grain(along, across, footprint, base, dice(board, board + seed, salt))
            gap = np.where(upright | rail, 1.0, np.minimum(across, pitch - across))
            seam = np.minimum(
                np.abs(np.minimum(u, w - u) - frame),
                np.where(upright, 1, np.abs(np.minimum(v, h - v) - frame)),
            )
            lip = np.where(
                upright | rail, 0.0, np.exp(-seam / 0.025)
            )  # the frame keeps light from the boards
            wood = tone(
                wood,
                -1.6 * (1 - ramp(gap, 0.004, soft))
                - 0.7 * lip
                - 1.2 * (1 - ramp(seam, 0.002, soft)),
            )
            ink = decal("graffiti", 40 + seed % 3).sample(
                (u - 0.2 * w) / (0.6 * w), (v - 0.25 * h) / (0.6 * h), footprint / (0.6 * min(w, h))
            )
            boards = (
                ~(upright | rail) & (u > 0.2 * w) & (u < 0.8 * w) & (v > 0.25 * h) & (v < 0.85 * h)
            )
            wood = mix(wood, linear("#2a2420")[None], 0.75 * ink[:, 3] * boards)
            nail_u, nail_v = np.minimum(u, w - u) - frame / 2, (v / pitch) % 1 * pitch - pitch / 2
            head = np.hypot(nail_u, nail_v)
            return mix(wood, linear("#2b2623")[None], 0.9 * (1 - ramp(head, 0.008, soft))), None

        return material

    return side


def louvres(w: float, h: float, colour: str = "#4f6f5c") -> Material:
    """Make a pair of slatted window shutters with peeling paint."""
    paint = linear(colour)

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        n = _noise(u, v, footprint, 0.8)
        soft = np.maximum(0.004, footprint)
        leaf = u % (w / 2)
        edge = np.minimum(
            np.minimum(leaf, w / 2 - leaf),
            np.minimum(np.minimum(v, h - v), np.abs(v - 0.55 * h) + 0.02),
        )
        pitch = 0.055
        slat = (v / pitch) % 1
        shade = (
            1.4 * (slat - 0.75) - 1.3 * ramp(slat, 0.9, np.maximum(0.1, footprint / pitch))
        ) * ramp(edge, 0.07, soft)
        bare = tone(linear("#9a8a72")[None], 0.3 * n[:, FINE])
        albedo = tone(
            paint[None],
            0.12 * n[:, FINE]
            + 0.1 * n[:, GRAIN]
            + 0.4 * (dice(v // pitch, u // (w / 2), 9)[:, 0] - 0.5),
        )
        albedo = mix(albedo, bare, ramp(n[:, FINE] + 0.4 * n[:, GRAIN], 1.5, 0.2))
        albedo = tone(albedo, shade.clip(-1.6, 0.25))
        return tone(albedo, -1.8 * (1 - ramp(np.minimum(leaf, w / 2 - leaf), 0.006, soft))), None

    return material


# ---- fired clay ----


def terracotta(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute a terracotta pot: wheel marks, a moulded garland and chalk stains."""
    n = _noise(0.4 * u, v, footprint, 0.8)
    soft = np.maximum(0.006, footprint)
    albedo = tone(
        linear("#b0623f")[None], 0.15 * n[:, FINE] + 0.1 * n[:, GRAIN] + 0.08 * np.sin(220 * v)
    )
    albedo = mix(
        albedo, linear("#d9cbb8")[None], 0.6 * ramp(n[:, BROAD] + 0.4 * n[:, FINE], 0.8, 1.2)
    )
    garland = np.abs(v - 0.2 - 0.03 * np.sin(26 * u))
    albedo = tone(
        albedo,
        -0.8 * (1 - ramp(garland, 0.008, soft))
        + 0.3 * (1 - ramp(np.abs(garland - 0.016), 0.006, soft)),
    )
    return tone(albedo, -0.7 * (1 - ramp(np.abs(v - 0.08), 0.006, soft))), None


def soil(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute dark soil with crumbs and a few chips of bark."""
    n = _noise(u, v, footprint, 0.5)
    earth = tone(linear("#4a3a2c")[None], 0.5 * n[:, FINE] + 0.4 * n[:, GRAIN] + 0.2 * n[:, RELIEF])
    return mix(earth, linear("#96754e")[None], ramp(n[:, FINE] + 0.5 * n[:, GRAIN], 1.7, 0.3)), None


def ceramic(rim: float) -> Material:
    """Make a glazed dish of radius `rim`: a star, petals, a scroll, a border and cracks."""
    white, blue, ochre, green = (linear(c) for c in ("#b3ad9c", "#1f3f7a", "#b57c28", "#386442"))

    def material(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        n = _noise(u + 0.3, v + 0.9, footprint, 0.6)
        r, a = np.hypot(u, v) / rim, np.arctan2(v, u) / (2 * np.pi)
        soft = np.maximum(0.006, footprint) / rim  # in units of the rim
        turn = soft / np.maximum(2 * np.pi * r, 0.05)
        wob = r + 0.006 * n[:, FINE]

        def line(at: float | Array, width: float) -> Array:
            return 1 - ramp(np.abs(wob - at), width / 2, soft)

        def wedge(count: int, width: float, phase: float = 0.0) -> Array:
            t = np.abs((a * count + phase) % 1 - 0.5)
            return 1 - ramp(t, width / 2, turn * count)

        def between(low: float, high: float) -> Array:
            return ramp(wob, low, soft) * (1 - ramp(wob, high, soft))

        paint = tone(np.broadcast_to(white, (len(u), 3)), 0.05 * n[:, FINE] + 0.04 * n[:, GRAIN])
        star = 0.2 + 0.09 * np.cos(2 * np.pi * 8 * a)
        petal = 0.42 + 0.09 * np.abs(np.sin(np.pi * 12 * a))
        layers = [
            (ochre, 1 - ramp(wob, star, soft)),
            (blue, line(star, 0.016)),
            (blue, 1 - ramp(wob, 0.07, soft)),
            (green, between(0.33, 0.5) * ramp(petal, wob, soft) * wedge(12, 0.55, 0.0)),
            (blue, line(petal, 0.014) + line(0.32, 0.012)),
            (
                ochre,
                between(0.55, 0.66)
                * wedge(24, 0.5)
                * (0.4 + 0.6 * dice(np.floor(24 * a), 0 * a, 21)[:, 0]),
            ),
            (
                blue,
                line(0.54, 0.01)
                + line(0.67, 0.01)
                + line(0.61 + 0.03 * np.sin(2 * np.pi * 36 * a), 0.01),
            ),
            (blue, between(0.71, 0.9) * _letters(a, (wob - 0.71) / 0.19, turn, soft)),
            (green, between(0.92, 1.1) * wedge(48, 0.5)),
            (blue, line(0.7, 0.008) + line(0.91, 0.012)),
        ]
        for colour, weight in layers:
            strength = np.clip(weight, 0, 1) * (0.88 + 0.06 * n[:, GRAIN].clip(-2, 2))
            paint = mix(paint, colour[None], strength)
        crackle = np.abs(n[:, FINE] - 0.3)
        paint = tone(paint, -0.35 * (1 - ramp(crackle, 0.04, np.maximum(0.05, 6 * footprint))))
        return mix(
            paint, linear("#8b6a4c")[None], 0.9 * ramp(n[:, BROAD] + 0.5 * n[:, FINE], 2.4, 0.1)
        ), None

    return material


def _letters(a: Array, height: Array, turn: Array, soft: Array) -> Array:
    """Compute a ring of 30 different signs of 3 x 4 dots each."""
    count = 30
    place = a * count
    k = np.floor(place)
    x, y = (place - k) * 4 - 0.5, height * 5 - 0.5
    col, row = np.floor(x), np.floor(y)
    inside = (col >= 0) & (col < 3) & (row >= 0) & (row < 4)
    on = dice(k * 5 + col, row, 33)[:, 0] < 0.55
    edge = np.minimum(np.minimum(x - col, 1 - x + col), 2)
    return inside * on * ramp(edge, 0.06, np.maximum(0.1, 4 * count * turn))


# ---- posters and graffiti ----


def with_decals(
    material: Material, *decals: tuple[str, int, tuple[float, float, float, float]]
) -> Material:
    """Add decals (kind, seed, (u0, v0, u1, v1) in metres) to `material`, with the same wear."""

    def covered(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
        albedo, slope = material(u, v, footprint)
        for kind, seed, (u0, v0, u1, v1) in decals:
            (at,) = np.nonzero((u > u0) & (u < u1) & (v > v0) & (v < v1))
            if not len(at):
                continue
            x, y, f = (u[at] - u0) / (u1 - u0), (v[at] - v0) / (v1 - v0), footprint[at]
            ink = decal(kind, seed).sample(x, y, f / min(u1 - u0, v1 - v0))
            n = _noise(u[at], v[at], f, 0.8)
            worn = 1 - 0.85 * ramp(
                n[:, FINE] + 0.4 * n[:, GRAIN], 1.5 if kind == "poster" else 1.1, 0.3
            )
            if kind == "poster":  # torn edges
                edge = np.minimum(
                    np.minimum(x, 1 - x) * (u1 - u0), np.minimum(y, 1 - y) * (v1 - v0)
                )
                worn = worn * ramp(edge + 0.006 * n[:, FINE], 0.012, np.maximum(0.003, f))
            shade = np.exp(0.06 * n[:, FINE] + 0.1 * n[:, RELIEF])
            alpha = (ink[:, 3] * worn * 0.95)[:, None]
            albedo[at] = albedo[at] * (1 - alpha) + ink[:, :3] * (worn * 0.95 * shade)[:, None]
        return albedo, slope

    return covered


def mural(u: Array, v: Array, footprint: Array) -> tuple[Array, Array | None]:
    """Compute a flat wall with varied content for planar scenes, about 8 x 6 m around (0, 0)."""
    brickwork, _ = brick(u + 20, v + 20, footprint)
    paint, _ = _MURAL_PAINT(u + 20, v + 20, footprint)
    n, m = _noise(u + 1.7, v + 2.9, footprint, 7.9), _noise(u, v, footprint, 1.7)
    return mix(
        brickwork, paint, ramp(n[:, BROAD] + 0.3 * n[:, FINE] + 0.12 * m[:, FINE], 0.1, 0.06)
    ), None


_MURAL_PAINT = plaster("#c9b48a")
