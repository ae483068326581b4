"""Damaged files of every kind: a reader succeeds or raises an SfmError, in bounded time.

The mutations are seeded. SFMKIT_MUTATIONS sets their number per file for longer runs.
"""

from __future__ import annotations

import io
import json
import os
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from sfmkit.errors import SfmError
from sfmkit.io.cameras import camera_from_exif
from sfmkit.io.colmap import read_colmap
from sfmkit.io.images import decode_image
from sfmkit.io.intrinsics import parse_intrinsics
from sfmkit.io.ply import read_ply
from sfmkit.io.truth import read_truth

COUNT = int(os.environ.get("SFMKIT_MUTATIONS", "15"))
SECONDS = 10  # that one file may take
# Pieces that parsers stumble over: limits of numbers, other separators, structure, other encodings.
PIECES = [
    *(b"", b"nan", b"inf", b"-1", b"0", b"1e999", b"9" * 30, b"9" * 5000, b"18446744073709551615"),
    *(b",", b";", b"[", b"]" * 50, b"[" * 3000, b"{", b"}", b":", b"\n", b"\r", b" ", b"\t", b"#"),
    *(b"\0", b"\xff", b"\xff\xff\xff\xff", b"\x80\x00\x00\x00", b"\xef\xbb\xbf", "ö²".encode()),
    *(b"- - - -", b"&a", b"*a", b"!!python/name:os.system", b"true", b"null", b'"', b"'", b"../"),
]


def mutations(data: bytes, seed: int) -> Iterator[bytes]:
    """Files near `data`: flipped bits, pieces put in, words exchanged, parts lost or doubled."""
    rng = np.random.default_rng(seed)
    for _ in range(COUNT):
        damaged = data
        for _ in range(rng.integers(1, 4)):
            kind, a, b = rng.integers(6), *sorted(rng.integers(0, len(damaged) + 1, 2))
            piece = PIECES[rng.integers(len(PIECES))]
            if kind == 0:
                damaged = damaged[:a] + piece + damaged[a:]
            elif kind == 1:
                damaged = damaged[:a] + piece + damaged[a + max(1, len(piece) % 8) :]
            elif kind == 2 and damaged:
                flipped = bytearray(damaged)
                flipped[a % len(flipped)] ^= 1 << rng.integers(8)
                damaged = bytes(flipped)
            elif kind == 3:
                damaged = damaged[:a] + damaged[min(b, a + 40) :]
            elif kind == 4:
                damaged = damaged[:b] + damaged[a:][:2000]
            else:
                words = damaged.split(b" ")
                words[rng.integers(len(words))] = piece
                damaged = b" ".join(words)
        yield damaged


def check(read: Callable[[bytes], object], data: bytes, seed: int) -> None:
    """Read `data`, which must succeed, and files near it, which must not raise anything else."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read(data)
        for number, damaged in enumerate(mutations(data, seed)):
            start, message = time.monotonic(), ""
            try:
                read(damaged)
            except SfmError as error:
                message = str(error)
            except Exception as error:
                raise AssertionError(f"mutation {number} of seed {seed}: {error!r}") from error
            assert len(message) < 2000, f"mutation {number} of seed {seed}: {message[:500]}"
            assert time.monotonic() - start < SECONDS, f"mutation {number} of seed {seed}"


def picture(kind: str, mode: str) -> bytes:
    rng = np.random.default_rng(0)
    rgb = cv2.GaussianBlur(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8), (0, 0), 1.5)
    image = PIL.Image.fromarray(rgb if mode != "I;16" else rgb[..., 0].astype(np.uint16) * 16)
    tags = PIL.Image.Exif()
    tags[0x0112], tags[0x010F], tags[0x0110] = 6, "DJI", "FC300X"
    sub = tags.get_ifd(0x8769)
    sub.update({0x920A: 3.61, 0xA405: 20, 0xA404: 2.0, 0xA20E: 500.0, 0xA20F: 500.0, 0xA210: 3})
    sub.update({0xA002: 64, 0xA003: 48})
    file = io.BytesIO()
    options = {"exif": tags} if kind in ("JPEG", "PNG", "TIFF", "WEBP") else {}
    if kind == "JPEG":
        options["xmp"] = b'<a drone-dji:CalibratedFocalLength="3666.5" drone-dji:x="1"/>'
    if mode not in ("RGB", "I;16"):
        image = image.convert(mode)
    image.save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize(
    "kind,mode",
    [
        *(("JPEG", "RGB"), ("JPEG", "L"), ("JPEG", "CMYK"), ("PNG", "RGB"), ("PNG", "P")),
        *(("PNG", "I;16"), ("TIFF", "RGB"), ("TIFF", "I;16"), ("TIFF", "F"), ("BMP", "RGB")),
        *(("WEBP", "RGB"), ("PPM", "RGB"), ("GIF", "P")),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_photographs(kind, mode, seed):
    def read(data: bytes) -> None:
        camera_from_exif(decode_image(data, Path("a.jpg")))

    check(read, picture(kind, mode), seed)


MATRIX = [[500.5, 0, 31.5], [0, 510.5, 23.5], [0, 0, 1]]
OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500.5, 0., 31.5, 0., 510.5, 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 1.0000000000000000e-02, 0., 0., 0. ]
"""
CALIBRATIONS = {
    "rows": "500.5 0 31.5\n0 510.5 23.5\n0 0 1\n-0.1 0.01 0 0 0\n",
    "line": "500.5, 510.5, 31.5, 23.5, -0.1\n",
    "json": json.dumps({"K": MATRIX, "size_wh": [64, 48], "distortion": [-0.1, 0.01]}),
    "opencv": OPENCV,
    "ros": "width: 64\nheight: 48\ndistortion_model: plumb_bob\nD: [-0.1, 0.01, 0, 0, 0]\n"
    "K: [500.5, 0, 31.5, 0, 510.5, 23.5, 0, 0, 1]\n",
    "kalibr": "cam0:\n  intrinsics: [500.5, 510.5, 31.5, 23.5]\n  resolution: [64, 48]\n",
    "matlab": "FocalLength: [500.5 510.5]\nPrincipalPoint: [32.5 24.5]\nImageSize: [48 64]\n"
    "RadialDistortion: [-0.1 0.01]\nTangentialDistortion: [0 0]\nSkew: 0\n",
    "colmap": "# cameras\n1 OPENCV 64 48 500.5 510.5 32 24 -0.1 0.01 0 0\n",
    "camera": "500.5 0 31.5\n0 510.5 23.5\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n64 48\n",
}


@pytest.mark.parametrize("name", CALIBRATIONS)
@pytest.mark.parametrize("seed", range(3))
def test_intrinsics(tmp_path, name, seed):
    def read(data: bytes) -> None:
        (tmp_path / "K").write_bytes(data)
        parse_intrinsics(tmp_path / "K", (64, 48), orientation=seed * 3 + 1)

    check(read, CALIBRATIONS[name].encode(), seed)


@pytest.mark.parametrize("seed", range(3))
def test_text_of_intrinsics(seed):
    def read(data: bytes) -> None:
        parse_intrinsics(data.decode("latin-1"), (64, 48))

    check(read, b"500.5,510.5,31.5,23.5,-0.1,0.01", seed)
    check(read, b"24mm/36mm", seed)


@pytest.mark.parametrize("seed", range(2))
def test_truth(tmp_path, seed):
    def read(data: bytes) -> None:
        (tmp_path / "t.json").write_bytes(data)
        read_truth(tmp_path / "t.json")

    check(read, json.dumps({"R": np.eye(3).tolist(), "t": [1, 0, 0.5]}).encode(), seed)


def colmap_files(folder: Path, suffix: str) -> dict[str, bytes]:
    """A model of two images as bytes."""
    from sfmkit.io.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
    from sfmkit.io.colmap.binary import write_binary
    from sfmkit.io.colmap.text import write_text

    camera = ColmapCamera("OPENCV", (64, 48), (50.0, 51.0, 32.0, 24.0, -0.1, 0.01, 0.0, 0.0))
    xy, ids = np.array([[1.0, 2], [3, 4.5]]), np.array([7, -1])
    images = {k: ColmapImage(f"im {k}.png", 1, np.eye(3), np.ones(3), xy, ids) for k in (1, 2)}
    point = ColmapPoint(np.ones(3), (1, 2, 3), 0.5, np.array([[1, 0], [2, 0]]))
    model = ColmapModel({1: camera}, images, {7: point})
    (write_binary if suffix == ".bin" else write_text)(folder, model)
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("seed", range(3))
def test_colmap_models(tmp_path, suffix, name, seed):
    files = colmap_files(tmp_path, suffix)

    def read(data: bytes) -> None:
        (tmp_path / (name + suffix)).write_bytes(data)
        for observations in (True, False):
            model = read_colmap(tmp_path, observations=observations)
            for image in model.images.values():
                model.camera(image)

    check(read, files[name + suffix], seed)


def ply_files() -> dict[str, bytes]:
    head = (
        "ply\nformat {} 1.0\ncomment operator bit 0 = orb\nelement vertex 3\nproperty float x\n"
        "property double y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nproperty list uchar uint ids\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    text = "0 1 2 9 8 7 1 5\n1 2 3 9 8 7 0\n4 5 6 1 2 3 2 1 1\n3 0 1 2\n"
    files = {"text": (head.format("ascii") + text).encode()}
    plain = head.replace("property list uchar uint ids\n", "")
    kind = [("x", "f4"), ("y", "f8"), ("z", "f4"), ("rgb", "u1", 3)]
    for order, name in (("<", "little"), (">", "big")):
        rows = np.zeros(3, np.dtype(kind).newbyteorder(order))
        rows["x"] = [1, 2, 3]
        faces = b"\3" + np.arange(3).astype(f"{order}i4").tobytes()
        header = plain.format(f"binary_{name}_endian").encode()
        files[name] = header + rows.tobytes() + faces
    return files


@pytest.mark.parametrize("name", ply_files())
@pytest.mark.parametrize("seed", range(4))
def test_clouds(tmp_path, name, seed):
    def read(data: bytes) -> None:
        (tmp_path / "c.ply").write_bytes(data)
        read_ply(tmp_path / "c.ply")

    check(read, ply_files()[name], seed)
