"""Photographs for the notebooks: real ones if available, otherwise bundled or rendered ones."""

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
    """Load two photographs with cameras and true pose, reduced so that a notebook runs fast.

    These are the first two photographs of the fountain sequence if ``SFMKIT_DATA`` or the download
    folder contains it, and the bundled pair otherwise.

    Args:
        longest: Longest side, pixels; the cameras are scaled accordingly.

    Returns:
        The pair, with images as (H, W, 3) uint8 RGB arrays.
    """
    pair = _full_size()
    assert pair.camera1 is not None
    assert pair.camera2 is not None
    (image1, camera1), (image2, camera2) = (
        _reduced(read_image(source).rgb, camera, longest)
        for source, camera in ((pair.image1, pair.camera1), (pair.image2, pair.camera2))
    )
    return replace(pair, image1=image1, image2=image2, camera1=camera1, camera2=camera2)


#: Change -> sequence of the Oxford set; the rendered sequences have the name of the change.
CHANGES = {
    "viewpoint": "graf",
    "zoom_rotation": "boat",
    "blur": "bikes",
    "light": "leuven",
    "jpeg": "ubc",
}


def lesson_planes(change: str, count: int = 5, size_wh: tuple[int, int] = (480, 384)) -> list[Pair]:
    """Load pairs of image 1 of a plane and images 2, 3, ... with a growing change, with true H.

    The images are those of the Oxford set if ``SFMKIT_DATA`` or the download folder contains it,
    and rendered otherwise.

    Args:
        change: One of :data:`CHANGES`.
        count: Number of pairs, at most 5.
        size_wh: Size of rendered images, pixels; smaller images are rendered faster.

    Returns:
        The pairs, with images as (H, W, 3) uint8 RGB arrays.

    Raises:
        InputError: The change is unknown.
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
