"""Photographs with EXIF in every format that is read."""

from __future__ import annotations

import io
from pathlib import Path
from random import Random

import numpy as np
import PIL.Image
from fuzz.engine import Kind, write
from fuzz.mutations import choose, mutate_bytes


def _exif() -> PIL.Image.Exif:
    exif = PIL.Image.Exif()
    exif[271], exif[272], exif[274] = "Canon", "EOS", 6  # make, model, orientation
    sub = exif.get_ifd(0x8769)
    sub[37386], sub[41989] = 35.0, 56  # focal length, in 35 mm film
    sub[41486], sub[41487], sub[41488] = 3000.0, 3000.0, 3  # focal plane resolution, unit
    sub[40962], sub[40963] = 48, 32
    return exif


def _seeds(_: Path) -> list[bytes]:
    rng = np.random.default_rng(0)
    rgb = PIL.Image.fromarray(rng.integers(0, 255, (32, 48, 3), np.uint8))
    deep = PIL.Image.fromarray(rng.integers(0, 4000, (32, 48)).astype(np.uint16))
    wide = PIL.Image.fromarray(rng.integers(0, 90_000, (32, 48)).astype(np.int32))
    real = PIL.Image.fromarray(rng.random((32, 48)).astype(np.float32))
    found = []
    for picture, format_, options in (
        (rgb, "JPEG", {"exif": _exif(), "quality": 80}),
        (rgb, "JPEG", {"progressive": True}),
        (rgb.convert("CMYK"), "JPEG", {}),
        (rgb, "PNG", {"exif": _exif()}),
        (rgb.convert("P"), "PNG", {}),
        (deep, "PNG", {}),
        (rgb, "TIFF", {"exif": _exif()}),
        (rgb, "TIFF", {"compression": "tiff_lzw"}),
        (deep, "TIFF", {}),
        (wide, "TIFF", {}),
        (real, "TIFF", {}),
        (rgb, "BMP", {}),
        (rgb, "WEBP", {"exif": _exif()}),
        (rgb, "PPM", {}),
        (deep, "PPM", {}),
        (rgb, "GIF", {}),
    ):
        memory = io.BytesIO()
        picture.save(memory, format_, **options)
        found.append(memory.getvalue())
    return [*found, b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n"]


def _mutate(random: Random, seeds: list[bytes]) -> bytes:
    return mutate_bytes(random, choose(random, seeds))


def _run(data: bytes, folder: Path) -> None:
    from sfmkit.io.cameras import camera_from_exif
    from sfmkit.io.images import read_image

    camera_from_exif(read_image(write(folder / "photo.jpg", data)))


KINDS = [Kind("images", _seeds, _mutate, _run)]
