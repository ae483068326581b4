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
from .rendering.scenes import Scene, look
from .synthetic import demo_pair, named_scene, render


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


def lesson_hard_pair(size_wh: tuple[int, int] = (512, 384)) -> Pair:
    """Return two photographs whose directions of view differ by more than 50 degrees.

    Second neighbours of the temple ring where ``SFMKIT_DATA`` or the cache holds it, else a
    rendered courtyard seen from both sides; with cameras and true pose.

    Args:
        size_wh: Size of the rendered images.

    Returns:
        The pair with its images as (H, W, 3) uint8 RGB arrays.
    """
    from .middlebury import temple_ring

    try:
        views = {view.path.stem: view for view in temple_ring()}
        a, b = views["templeSR0003"], views["templeSR0002"]
    except (InputError, KeyError):
        p = render(_apart(), size_wh=size_wh, blur=0.8, noise=2.0, jpeg_quality=90)
        return Pair(
            "synthetic",
            "courtyard",
            "apart",
            p.image1,
            p.image2,
            p.camera1,
            p.camera2,
            R=p.R,
            t=p.t,
        )
    R = b.R @ a.R.T
    return Pair(
        "middlebury",
        "temple",
        f"{a.path.stem}-{b.path.stem}",
        read_image(a.path).rgb,
        read_image(b.path).rgb,
        a.camera,
        b.camera,
        R=R,
        t=b.t - R @ a.t,
    )


def _apart() -> Scene:
    """The courtyard from the left and from the right."""
    left = look((-1.9, -1.6, 3.4), (0.9, -1.3, 7.0))
    right = look((3.1, -1.9, 3.8), (-0.3, -1.3, 6.6), -3)
    return Scene("apart", named_scene("courtyard").surfaces, left, right)


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
