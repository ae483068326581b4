"""Photographs with a COLMAP text model as their truth: cameras and poses of images that were
reconstructed together."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..types import Camera
from .pair import Pair

# model -> which of fx, fy, cx, cy, k1, k2, p1, p2, k3 its parameters are; f is fx and fy
_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}


def colmap(model: str | os.PathLike, images: str | os.PathLike) -> Iterator[Pair]:
    """Each registered image with the next one by name, with cameras and pose.

    Args:
        model: folder with ``cameras.txt`` and ``images.txt``.
        images: folder that the names in ``images.txt`` are relative to.

    Raises:
        InputError: files that are missing or cannot be read, camera models with more than
            radial-tangential distortion, fewer than two images.
    """
    model, images = Path(model), Path(images)
    cameras = {int(words[0]): _camera(words, model) for words in _lines(model / "cameras.txt")}
    # Every second line of images.txt lists 2-D points; a line of an image ends with its name.
    poses = {}
    for words in _lines(model / "images.txt", every=2):
        try:
            q, t, camera, name = (
                np.array(words[1:5], float),
                np.array(words[5:8], float),
                int(words[8]),
                words[9],
            )
            poses[name] = (_rotation(q), t, cameras[camera])
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(
                f"{model / 'images.txt'}: cannot read the image '{' '.join(words)[:60]}' ({error})"
            ) from None
    if len(poses) < 2:
        raise InputError(f"{model} holds {len(poses)} images; a pair takes two")
    for a, b in pairwise(sorted(poses)):
        for name in (a, b):
            if not (images / name).is_file():
                raise InputError(f"the model in {model} names {name}, which is not in {images}")
        (R1, t1, camera1), (R2, t2, camera2) = poses[a], poses[b]
        R = R2 @ R1.T
        yield Pair(
            "colmap",
            model.name,
            f"{Path(a).stem}-{Path(b).stem}",
            images / a,
            images / b,
            camera1,
            camera2,
            R=R,
            t=t2 - R @ t1,
        )


def _lines(path: Path, every: int = 1) -> list[list[str]]:
    """The words of every `every`-th line, comments left out."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None
    return [
        words
        for line in [ln for ln in lines if not ln.startswith("#")][::every]
        if (words := line.split())
    ]


def _camera(words: list[str], model: Path) -> Camera:
    """``ID MODEL WIDTH HEIGHT PARAMETERS``. COLMAP's pixel centres are at half numbers, ours at
    whole ones."""
    if len(words) < 4 or words[1] not in _MODELS:
        raise InputError(
            f"{model / 'cameras.txt'}: '{' '.join(words[:2])}' is not supported; export with one of {', '.join(_MODELS)}"
        )
    names = _MODELS[words[1]]
    try:
        size, values = (int(words[2]), int(words[3])), [float(word) for word in words[4:]]
    except ValueError as error:
        raise InputError(f"{model / 'cameras.txt'}: {error}") from None
    if len(values) != len(names):
        raise InputError(
            f"{model / 'cameras.txt'}: {words[1]} takes {len(names)} parameters, not {len(values)}"
        )
    p = dict(zip(names, values))
    fx, fy = p.get("f", p.get("fx", 0.0)), p.get("f", p.get("fy", 0.0))
    K = np.array([[fx, 0, p["cx"] - 0.5], [0, fy, p["cy"] - 0.5], [0, 0, 1]])
    return Camera(K, size, np.array([p.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]))


def _rotation(q: np.ndarray) -> np.ndarray:
    """(3, 3) of the quaternion w, x, y, z."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
