"""Intrinsics, true poses and homographies in files and as text."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

from fuzz.engine import Kind, write
from fuzz.mutations import choose, mutate_bytes, mutate_json, mutate_text

K = [[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]]
ROWS = b"500 0 319.5\n0 500 239.5\n0 0 1\n"
CAMERA = ROWS + b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 2 3\n640 480\n"
YAML = b"""%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 319.5, 0., 500., 239.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, -0.01, 0., 0., 0. ]
"""
INTRINSICS = [
    b"500,500,319.5,239.5",
    b"500,500,319.5,239.5,0.1,-0.01,0,0,0",
    ROWS,
    CAMERA,
    YAML,
    b"1 PINHOLE 640 480 500 500 319.5 239.5\n",
    json.dumps({"K": K, "size_wh": [640, 480], "distortion": [0.1, 0, 0, 0]}).encode(),
]
TRUTH = [
    json.dumps({"K": K, "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [1, 0, 0]}).encode(),
    CAMERA,
]
SUFFIXES = (".txt", ".json", ".yaml", ".yml", ".xml", ".camera", "")


def _mutate(random: Random, seeds: list[bytes]) -> bytes:
    data = choose(random, seeds)
    if data.startswith(b"{") and random.random() < 0.8:
        try:
            return mutate_json(random, data)
        except ValueError:  # two seeds in one
            return data
    return random.choice((mutate_text, mutate_text, mutate_bytes))(random, data)


def _intrinsics(data: bytes, folder: Path) -> None:
    from sfmkit.io.intrinsics import parse_intrinsics

    for suffix in SUFFIXES[len(data) % len(SUFFIXES) :][:2]:
        parse_intrinsics(write(folder / f"K{suffix}", data), (640, 480))


def _text(data: bytes, folder: Path) -> None:
    from sfmkit.io.intrinsics import parse_intrinsics

    parse_intrinsics(data.decode("utf-8", "surrogateescape"), (640, 480))


def _truth(data: bytes, folder: Path) -> None:
    from sfmkit.io.truth import read_truth

    if data.lstrip()[:1] in (b"{", b"["):
        read_truth(write(folder / "truth.json", data))
    else:
        a, b = write(folder / "a.png.camera", data), write(folder / "b.png.camera", CAMERA)
        read_truth(f"{a},{b}")


def _homography(data: bytes, folder: Path) -> None:
    from sfmkit.datasets.pair import read_homography

    read_homography(write(folder / "H1to2p", data))


KINDS = [
    Kind("intrinsics", lambda _: INTRINSICS, _mutate, _intrinsics),
    Kind("intrinsics-text", lambda _: INTRINSICS[:2], _mutate, _text),
    Kind("truth", lambda _: TRUTH, _mutate, _truth),
    Kind("homography", lambda _: [ROWS, b"1 0 5\n0 1 -3\n1e-4 0 1\n"], _mutate, _homography),
]
