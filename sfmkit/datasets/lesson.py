"""The photographs that the notebooks work on: real ones where they are, bundled or rendered ones
otherwise."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice

import cv2
import numpy as np

from ..errors import InputError
from ..io.images import read_image
from ..io.intrinsics import parse_intrinsics
from ..types import Camera
from .pair import Pair
from .synthetic import demo_pair


def lesson_pair(longest: int = 1000) -> Pair:
    """Two photographs with cameras and true pose, reduced so that a lesson does not wait for them.

    The first two of the fountain sequence where ``SFMKIT_DATA`` or the cache holds it, else the
    bundled pair.

    Args:
        longest: longest side in pixels; the cameras are scaled along.

    Returns:
        The pair, its images as (H, W, 3) uint8 RGB arrays.
    """
    pair = _full_size()
    assert pair.camera1 is not None
    assert pair.camera2 is not None
    (image1, camera1), (image2, camera2) = (
        _reduced(read_image(source).rgb, camera, longest)
        for source, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2))
    )
    return replace(pair, image1=image1, image2=image2, camera1=camera1, camera2=camera2)


#: change -> the sequence of the Oxford set that shows it; the rendered ones are named by the change
CHANGES = {
    "viewpoint": "graf",
    "zoom_rotation": "boat",
    "blur": "bikes",
    "light": "leuven",
    "jpeg": "ubc",
}


def lesson_planes(change: str, count: int = 5, size_wh: tuple[int, int] = (480, 384)) -> list[Pair]:
    """Image 1 of a plane with image 2, 3 ... of it, the change growing, and their true
    homographies.

    The Oxford set's where ``SFMKIT_DATA`` or the cache holds it, else rendered.

    Args:
        change: one of :data:`CHANGES`.
        count: of pairs, at most 5.
        size_wh: of rendered images; fewer pixels are rendered sooner.

    Returns:
        The pairs, their images as (H, W, 3) uint8 RGB arrays.

    Raises:
        InputError: unknown change.
    """
    from .oxford import oxford
    from .planes import planes

    if change not in CHANGES:
        raise InputError(f"unknown change '{change}'; there are {', '.join(CHANGES)}")
    try:
        pairs = list(islice(oxford(sequences=[CHANGES[change]]), count))
    except InputError:
        return list(islice(planes(sequences=[change], size_wh=size_wh), count))
    return [
        replace(p, image1=read_image(p.image1).rgb, image2=read_image(p.image2).rgb) for p in pairs
    ]


def _reduced(rgb: np.ndarray, camera: Camera, longest: int) -> tuple[np.ndarray, Camera]:
    scale = min(1.0, longest / max(rgb.shape[:2]))
    size_wh = (round(rgb.shape[1] * scale), round(rgb.shape[0] * scale))
    small = rgb if scale == 1 else cv2.resize(rgb, size_wh, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), camera.scaled(size_wh)


def _full_size() -> Pair:
    from .strecha import strecha

    try:
        return next(strecha(sequences=["fountain-P11"]))
    except (InputError, StopIteration):
        image1, image2, file = demo_pair()
        truth = json.loads(file.read_text())
        camera = parse_intrinsics(file, tuple(truth["size_wh"]))
        return Pair(
            "synthetic",
            truth["scene"],
            "1-2",
            image1,
            image2,
            camera,
            camera,
            R=np.array(truth["R"]),
            t=np.array(truth["t"]),
        )
