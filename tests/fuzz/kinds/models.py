"""COLMAP models in text and binary, and PLY clouds."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from random import Random

import cv2
import numpy as np
from fuzz.engine import Kind, write
from fuzz.mutations import choose, mutate_bytes, mutate_text

FILES = ("cameras", "images", "points3D")
TEXT = (
    b"# cameras\n1 PINHOLE 640 480 500 500 319.5 239.5\n2 OPENCV 640 480 500 500 320 240 0 0 0 0\n",
    b"# images\n1 1 0 0 0 0 0 0 1 a b.png\n10 20 7 30 40 -1\n2 1 0 0 0 1 0 0 2 c.png\n\n",
    b"# points\n7 1 2 3 255 0 9 0.5 1 0 2 1\n",
)
SEPARATOR = b"\n--8<--\n"
BINARY = (
    struct.pack("<QIiQQ4d", 1, 1, 1, 640, 480, 500, 500, 319.5, 239.5),
    struct.pack("<QI7dI", 2, 1, 1, 0, 0, 0, 0, 0, 0, 1)
    + b"a.png\0"
    + struct.pack("<Qddq", 1, 10.0, 20.0, 7)
    + struct.pack("<I7dI", 2, 1, 0, 0, 0, 1, 0, 0, 1)
    + b"c.png\0"
    + struct.pack("<Q", 0),
    struct.pack("<QQ3d3BdQII", 1, 7, 1, 2, 3, 255, 0, 9, 0.5, 1, 1, 0),
)


def _mutate_model(random: Random, seeds: list[bytes]) -> bytes:
    parts = random.choice(seeds).split(SEPARATOR)
    at = random.randrange(len(parts))
    change = mutate_text if seeds[0].startswith(b"#") else mutate_bytes
    parts[at] = change(random, parts[at])
    return SEPARATOR.join(parts)


def _model(suffix: str):
    def run(data: bytes, folder: Path) -> None:
        from sfmkit.datasets.colmap import colmap
        from sfmkit.io.colmap import read_colmap

        (folder / "images").mkdir()
        for name in ("a.png", "a b.png", "c.png"):
            cv2.imwrite(str(folder / "images" / name), np.zeros((48, 64), np.uint8))
        for name, part in zip(FILES, data.split(SEPARATOR), strict=False):
            write(folder / f"{name}{suffix}", part)
        model = read_colmap(folder)
        for image in model.images.values():
            model.camera(image)
        list(colmap(folder))

    return run


def _ply(format_: str) -> bytes:
    rng = np.random.default_rng(0)
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    order = ">" if format_ == "binary_big_endian" else "<"
    rows = np.zeros(5, dtype=[(name, order + kind) for name, kind in kinds])
    for name in "xyz":
        rows[name] = rng.normal(size=5)
    names = {"f4": "float", "f8": "double", "u1": "uchar"}
    head = f"ply\nformat {format_} 1.0\ncomment made\nelement vertex 5\n"
    head += "".join(f"property {names[kind]} {name}\n" for name, kind in kinds)
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    memory = io.BytesIO()
    memory.write(head.encode())
    if format_ == "ascii":
        memory.write("".join(" ".join(map(str, row)) + "\n" for row in rows.tolist()).encode())
        memory.write(b"3 0 1 2\n")
    else:
        memory.write(rows.tobytes())
        memory.write(struct.pack(order + "B3i", 3, 0, 1, 2))
    return memory.getvalue()


def _mutate_ply(random: Random, seeds: list[bytes]) -> bytes:
    data = choose(random, seeds)
    if random.random() < 0.5:
        head, end, body = data.partition(b"end_header\n")
        return mutate_text(random, head) + end + body
    return mutate_bytes(random, data)


def _read_ply(data: bytes, folder: Path) -> None:
    from sfmkit.io.ply import read_ply

    read_ply(write(folder / "cloud.ply", data))


KINDS = [
    Kind("colmap-text", lambda _: [SEPARATOR.join(TEXT)], _mutate_model, _model(".txt")),
    Kind("colmap-binary", lambda _: [SEPARATOR.join(BINARY)], _mutate_model, _model(".bin")),
    Kind(
        "ply",
        lambda _: [_ply(f) for f in ("ascii", "binary_little_endian", "binary_big_endian")],
        _mutate_ply,
        _read_ply,
    ),
]
