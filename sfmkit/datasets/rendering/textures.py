"""Procedural image content: noise with natural statistics, drawn decals, and anti-aliased sampling.

A texture is a mip pyramid (Williams 1983, "Pyramidal parametrics"). It is sampled at the level
whose texels have the size of the footprint of a pixel. Colours are linear light, not sRGB.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from PIL import Image, ImageDraw

Array = np.ndarray


class Texture:
    """A square image, repeated over the plane, with its mip pyramid.

    Args:
        base: (S, S, C) values; S is a power of two.
    """

    def __init__(self, base: Array) -> None:
        self.size, channels = base.shape[0], base.shape[2]
        levels: list[Array] = [base.astype(np.float32)]
        while levels[-1].shape[0] > 1:
            a = levels[-1]
            levels.append((a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2]) / 4)
        self.texels = np.concatenate([a.reshape(-1, channels) for a in levels])
        self.sizes = np.array([len(a) for a in levels], dtype=np.int64)
        self.offsets = np.concatenate([[0], np.cumsum(self.sizes**2)[:-1]])

    def sample(self, u: Array, v: Array, footprint: Array) -> Array:
        """Interpolate (N, C) values at `u`, `v`, averaged over about `footprint` (all in periods).

        The interpolation is trilinear.
        """
        level = np.log2(np.maximum(footprint * self.size, 1)).clip(0, len(self.sizes) - 1.001)
        lower = level.astype(np.int64)
        blend = (level - lower).astype(np.float32)[:, None]
        fine, coarse = self._bilinear(u, v, lower), self._bilinear(u, v, lower + 1)
        return fine + blend * (coarse - fine)

    def _bilinear(self, u: Array, v: Array, level: Array) -> Array:
        size = self.sizes[level]
        x, y = u * size - 0.5, v * size - 0.5
        x0, y0 = np.floor(x), np.floor(y)
        fx, fy = (x - x0).astype(np.float32)[:, None], (y - y0).astype(np.float32)[:, None]
        mask, offset = size - 1, self.offsets[level]
        c0 = x0.astype(np.int64) & mask
        c1 = (c0 + 1) & mask
        r0 = y0.astype(np.int64) & mask
        r1 = offset + ((r0 + 1) & mask) * size
        r0 = offset + r0 * size
        top = self.texels.take(r0 + c0, axis=0)
        top += fx * (self.texels.take(r0 + c1, axis=0) - top)
        bottom = self.texels.take(r1 + c0, axis=0)
        bottom += fx * (self.texels.take(r1 + c1, axis=0) - bottom)
        return top + fy * (bottom - top)


def power_law(size: int, exponent: float, rng: np.random.Generator) -> Array:
    """Draw (size, size) periodic Gaussian noise with amplitude spectrum ``1 / f^exponent``.

    The mean is 0 and the variance 1.

    Photographs have an exponent near 1 (Field 1987; Ruderman and Bialek 1994).
    """
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    f[0, 0] = np.inf
    noise = np.fft.irfft2(
        np.fft.rfft2(rng.standard_normal((size, size))) / f**exponent, s=(size, size)
    )
    return (noise - noise.mean()) / noise.std()


FINE, GRAIN, BROAD, RELIEF = range(4)


@cache
def noise() -> Texture:
    """Make a texture of four noises: FINE (1/f), GRAIN (1/f^0.4), BROAD (1/f^1.6) and RELIEF.

    RELIEF is FINE lit from the side.
    """
    rng = np.random.default_rng(20240607)
    fine, grain, broad = (power_law(1024, a, rng) for a in (1.0, 0.4, 1.6))
    lit = np.roll(fine, (2, 2), (0, 1)) - fine
    return Texture(np.stack([fine, grain, broad, lit / lit.std()], axis=-1))


@cache
def _dice() -> Array:
    return np.random.default_rng(77).random((8192, 4), dtype=np.float32)


def dice(i: Array, j: Array, salt: int = 0) -> Array:
    """Return (N, 4) pseudo-random numbers in [0, 1) for the cells (i, j) of a lattice."""
    i, j = np.asarray(i).astype(np.int64), np.asarray(j).astype(np.int64)
    return _dice().take((i * 1619 + j * 31337 + salt * 6971 ^ (i * j & 1023) * 7) & 8191, axis=0)


def linear(colour: str) -> Array:
    """Convert an sRGB colour ``#rrggbb`` to (3,) linear light (IEC 61966-2-1)."""
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb(light: Array) -> Array:
    """Convert linear light to sRGB values, clipped to [0, 1] (IEC 61966-2-1)."""
    c = np.clip(light, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)


def ramp(x: Array, edge: float | Array, width: float | Array) -> Array:
    """Compute a step at `edge` from 0 to 1, averaged over a footprint of `width`."""
    return np.clip((x - edge) / width + 0.5, 0, 1)


# ---- decals: transparent pictures on a surface ----

Stroke = list[tuple[float, float]]
INKS = ("#1c1b1f", "#8c1d1d", "#123c69", "#e6dfcc", "#1f5f43", "#c7961f", "#5b2a66", "#d9482b")


def _glyph(rng: np.random.Generator) -> list[Stroke]:
    """Draw letter-like strokes in the unit square: arcs and bars between lattice points."""
    strokes: list[Stroke] = []
    at = rng.integers(0, 3, 2)
    for _ in range(rng.integers(2, 5)):
        to = rng.integers(0, 3, 2)
        if (to == at).all():
            to = np.array([(at[0] + 1) % 3, at[1]])
        bend = rng.choice([0.0, 0.0, 0.45, -0.45])
        s = np.linspace(0, 1, 9 if bend else 2)[:, None]
        d = (to - at) / 2
        points = at / 2 + s * d + bend * 4 * s * (1 - s) * np.array([-d[1], d[0]])
        strokes.append([(float(x), float(y)) for x, y in points])
        at = to if rng.random() < 0.7 else rng.integers(0, 3, 2)
    return strokes


def _draw_glyph(
    pen: ImageDraw.ImageDraw, glyph: list[Stroke], box: Array, width: int, ink: str
) -> None:
    (x, y, w, h), r = box, width / 2
    for stroke in glyph:
        points = [(x + w * p, y + h * q) for p, q in stroke]
        pen.line(points, fill=ink, width=width, joint="curve")
        for px, py in (points[0], points[-1]):
            pen.ellipse((px - r, py - r, px + r, py + r), fill=ink)


def _graffiti(pen: ImageDraw.ImageDraw, size: int, rng: np.random.Generator) -> None:
    """Draw a word in thick outlined letters, an underline, and thin tags around it."""
    fill, outline = rng.choice(INKS[1:], 2, replace=False)
    n, x = 5, 0.06
    boxes = []
    for _ in range(n):
        w, h = rng.uniform(0.11, 0.14), rng.uniform(0.3, 0.42)
        boxes.append((np.array([x, rng.uniform(0.2, 0.3), w, h]) * size, _glyph(rng)))
        x += w + rng.uniform(0.045, 0.06)
    for width, ink in ((0.062, INKS[0]), (0.048, str(fill)), (0.012, str(outline))):
        for box, glyph in boxes:
            _draw_glyph(pen, glyph, box, int(width * size), ink)
    s = np.linspace(0, 1, 60)
    wave = [
        (float(a), float(b))
        for a, b in np.stack([0.05 + 0.9 * s, 0.76 + 0.03 * np.sin(9 * s)], 1) * size
    ]
    pen.line(wave, fill=str(outline), width=int(0.015 * size), joint="curve")
    for _ in range(4):
        x, y, ink = rng.uniform(0.02, 0.6), rng.choice([0.05, 0.83, 0.9]), str(rng.choice(INKS))
        for k in range(rng.integers(4, 8)):
            box = np.array([x + 0.05 * k, y, 0.032, 0.06]) * size
            _draw_glyph(pen, _glyph(rng), box, max(2, int(0.008 * size)), ink)


def _poster(pen: ImageDraw.ImageDraw, size: int, rng: np.random.Generator) -> None:
    """Draw a poster with a headline, a picture of overlapping shapes and columns of text."""
    paper, head = (
        rng.choice(["#efe6cf", "#e7d9b4", "#dfe3df", "#f0c75e"]),
        str(rng.choice(INKS[:3])),
    )
    pen.rectangle((0, 0, size, size), fill=str(paper))
    pen.rectangle(
        (0.03 * size, 0.03 * size, 0.97 * size, 0.97 * size), outline=head, width=int(0.008 * size)
    )
    for k in range(7):
        box = np.array([0.08 + 0.123 * k, 0.07, 0.085, 0.11]) * size
        _draw_glyph(pen, _glyph(rng), box, int(0.02 * size), head)
    pen.rectangle((0.08 * size, 0.24 * size, 0.92 * size, 0.62 * size), fill=str(rng.choice(INKS)))
    for _ in range(14):
        c, r = rng.uniform((0.16, 0.3), (0.84, 0.56)) * size, rng.uniform(0.02, 0.08) * size
        shape = [
            (float(c[0] + r * np.cos(a)), float(c[1] + r * np.sin(a)))
            for a in rng.uniform(0, 6.28, 4)
        ]
        ink = str(rng.choice(INKS))
        if rng.random() < 0.5:
            pen.ellipse((c[0] - r, c[1] - r, c[0] + r, c[1] + r), fill=ink)
        else:
            pen.polygon(shape, fill=ink)
    for row in range(11):
        for k in range(28):
            if rng.random() < 0.14:  # a space between words
                continue
            box = np.array([0.08 + 0.03 * k, 0.66 + 0.027 * row, 0.016, 0.016]) * size
            _draw_glyph(pen, _glyph(rng), box, max(2, int(0.004 * size)), "#26262a")


@cache
def decal(kind: str, seed: int) -> Texture:
    """Draw ``graffiti`` or a ``poster`` on the unit square: (R, G, B) times opacity, opacity."""
    rng = np.random.default_rng(seed)
    size = 2048
    canvas = Image.new("RGBA", (size, size), (0, 0, 0, 0))
    {"graffiti": _graffiti, "poster": _poster}[kind](ImageDraw.Draw(canvas), size, rng)
    a = (
        np.asarray(canvas.resize((size // 4, size // 4), Image.Resampling.BOX), dtype=np.float32)
        / 255
    )
    light = np.where(
        a[..., :3] <= 0.04045, a[..., :3] / 12.92, ((a[..., :3] + 0.055) / 1.055) ** 2.4
    )
    return Texture(np.concatenate([light * a[..., 3:], a[..., 3:]], axis=-1))
