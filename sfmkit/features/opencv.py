"""OpenCV's detectors and descriptors with an interface of arrays.

``cv2.KeyPoint`` is used only in this file. Every call creates its own ``cv2.Feature2D``, so calls
can run in parallel threads (OpenCV releases the GIL).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import cv2
import numpy as np

from ..errors import InputError, OperatorError
from .tables import DESCRIPTORS, DETECTORS

_ORB_LEVEL_RATIO = 1.2


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of one image as arrays.

    Attributes:
        xy: (N, 2) float32 pixels.
        sizes: (N,) float32 diameters as defined by the detector of OpenCV, pixels.
        angles: (N,) float32 degrees, clockwise on screen; -1 for none.
        scores: (N,) float32 detector responses.
        octaves: (N,) int64 pyramid levels, as coded by the detector.
    """

    xy: np.ndarray
    sizes: np.ndarray
    angles: np.ndarray
    scores: np.ndarray
    octaves: np.ndarray

    def __len__(self) -> int:
        return len(self.xy)

    def take(self, index: np.ndarray) -> Keypoints:
        """Return the keypoints at `index`, in that order."""
        return Keypoints(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def _from_cv(keypoints: tuple[cv2.KeyPoint, ...]) -> Keypoints:
    n = len(keypoints)
    xy = np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float32).reshape(n, 2)
    sizes, angles, scores = (
        np.fromiter(map(attrgetter(name), keypoints), np.float32, n)
        for name in ("size", "angle", "response")
    )
    return Keypoints(
        xy, sizes, angles, scores, np.fromiter(map(attrgetter("octave"), keypoints), np.int64, n)
    )


def _to_cv(kp: Keypoints) -> list[cv2.KeyPoint]:
    """Convert to ``cv2.KeyPoint``, with the row as `class_id`.

    The row identifies the keypoints that OpenCV drops.
    """
    columns = (
        kp.xy[:, 0],
        kp.xy[:, 1],
        kp.sizes,
        kp.angles,
        kp.scores,
        kp.octaves,
        np.arange(len(kp)),
    )
    return list(map(cv2.KeyPoint, *(column.tolist() for column in columns)))


def has(create: str) -> bool:
    """Return whether this build of OpenCV has a factory, e.g. ``xfeatures2d.FREAK_create``."""
    try:
        attrgetter(create)(cv2)
    except AttributeError:
        return False
    return True


def _create(what: str, create: str, options: dict[str, Any]) -> cv2.Feature2D:
    try:
        return attrgetter(create)(cv2)(**options)
    except (cv2.error, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"OpenCV does not accept these options of {what}: {options} ({_reason(error)})"
        ) from error


def _reason(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1].strip() if lines else type(error).__name__


def _run(what: str, grey: np.ndarray, function: Any, *args: Any) -> Any:
    try:
        return function(grey, *args)
    except (cv2.error, MemoryError) as error:
        h, w = grey.shape
        raise OperatorError(
            f"OpenCV could not run {what} on this {w} x {h} image ({_reason(error)}); "
            "try other options, or max_size to search a smaller image"
        ) from error


def _detector(name: str, options: dict[str, Any]) -> cv2.Feature2D:
    spec = DETECTORS[name]
    assert spec.create is not None
    return _create(name, spec.create, {**spec.fixed, **options})


def detect(grey: np.ndarray, name: str, options: dict[str, Any]) -> Keypoints:
    """Detect keypoints, in the order of OpenCV.

    Args:
        grey: (H, W) uint8 image.
        name: A detector of :data:`~sfmkit.features.tables.DETECTORS`.
        options: Its options, under OpenCV's names.

    Raises:
        InputError: OpenCV does not accept the options.
        OperatorError: OpenCV fails on this image.
    """
    if min(grey.shape) < DETECTORS[name].min_side:
        return _from_cv(())
    return _from_cv(_run(name, grey, _detector(name, options).detect))


def detect_and_describe(
    grey: np.ndarray, name: str, options: dict[str, Any]
) -> tuple[Keypoints, np.ndarray]:
    """Detect and describe keypoints in one pass.

    This is for the operators of OpenCV that have a detector and a descriptor (SIFT, ORB, AKAZE,
    KAZE, BRISK). Arguments and errors are those of :func:`detect`. The descriptors of an image
    without keypoints have the shape (0, width).
    """
    feature = _detector(name, options)
    if min(grey.shape) < DETECTORS[name].min_side:
        return _from_cv(()), _empty(feature)
    keypoints, descriptors = _run(name, grey, feature.detectAndCompute, None)
    return _from_cv(keypoints), _empty(feature) if descriptors is None else descriptors


def describable(
    xy: np.ndarray, name: str, options: dict[str, Any], size_wh: tuple[int, int]
) -> np.ndarray:
    """Return which keypoints have a patch inside the image, (N,) bool.

    If the size of the patch is not known in advance, the result is true for all.
    """
    margin = DESCRIPTORS[name].margin + options.get("half_ssd_size", 0)
    if not margin:
        return np.ones(len(xy), dtype=bool)
    at = np.rint(xy)
    return ((at >= margin) & (at < np.array(size_wh) - margin)).all(axis=1)


def describe(
    grey: np.ndarray, kp: Keypoints, detector: str, name: str, options: dict[str, Any]
) -> tuple[Keypoints, np.ndarray]:
    """Compute descriptors at the keypoints of any detector.

    Args:
        grey: (H, W) uint8 image.
        kp: The keypoints.
        detector: The detector that found them; their sizes are converted to those of FAST (see
            ``DetectorSpec.fast_size``).
        name: A descriptor of :data:`~sfmkit.features.tables.DESCRIPTORS`.
        options: Its options, under OpenCV's names.

    Returns:
        The M keypoints that have a descriptor, in the given order, with the orientation that was
        used; and the descriptors (M, D). OpenCV drops keypoints whose patch extends beyond the
        image.
    """
    spec = DESCRIPTORS[name]
    assert spec.create is not None
    feature = _create(name, spec.create, {**spec.fixed, **options})
    if not len(kp):
        return kp, _empty(feature)
    sizes = kp.sizes * np.float32(DETECTORS[detector].fast_size)
    octaves = np.zeros_like(kp.octaves)
    if spec.reads_octave:
        level = np.rint(np.log(sizes / 7) / np.log(_ORB_LEVEL_RATIO))
        octaves = np.clip(level, 0, 7).astype(np.int64)
    # Descriptors that do not test for a missing orientation interpret OpenCV's -1 as an angle.
    angles = kp.angles if spec.reads_missing_angle else upright_is_zero(kp.angles)
    given = replace(kp, sizes=sizes, octaves=octaves, angles=angles)
    described, descriptors = _run(f"{detector}+{name}", grey, feature.compute, _to_cv(given))
    if descriptors is None or not len(described):
        return kp.take(np.arange(0)), _empty(feature)
    row = np.fromiter(map(attrgetter("class_id"), described), np.int64, len(described))
    order = np.argsort(row, kind="stable")
    kept = kp.take(row[order])
    if spec.orients:
        kept = replace(kept, angles=_from_cv(described).angles[order])
    return kept, descriptors[order]


def upright_is_zero(angles: np.ndarray) -> np.ndarray:
    """Return degrees in [0, 360), with 0 where OpenCV's -1 stands for no orientation."""
    return np.where(angles == -1, 0, angles % 360).astype(np.float32)


def _empty(feature: cv2.Feature2D) -> np.ndarray:
    kind = np.float32 if feature.descriptorType() == cv2.CV_32F else np.uint8
    return np.zeros((0, feature.descriptorSize()), dtype=kind)


def centroid_angles(grey: np.ndarray, xy: np.ndarray, radius: int = 15) -> np.ndarray:
    """Compute the orientation of corners from the intensity centroid.

    The orientation is the direction from the corner to the centroid of the disc around it. With it,
    the descriptors of an upright corner detector become invariant to rotation.

    Args:
        grey: (H, W) uint8 image.
        xy: (N, 2) pixels inside the image.
        radius: Radius of the disc in pixels.

    Returns:
        (N,) float32 degrees in [0, 360), clockwise on screen.

    Source: Rosin 1999; Rublee et al. 2011, eqs. 1-3.
    """
    side = 2 * radius + 1
    offset = np.arange(-radius, radius + 1, dtype=np.float32)
    disc = (offset[:, None] ** 2 + offset**2 <= radius**2).astype(np.float32)
    moments = np.stack([disc * offset, disc * offset[:, None]], axis=-1).reshape(side * side, 2)
    padded = cv2.copyMakeBorder(grey, radius, radius, radius, radius, cv2.BORDER_REFLECT_101)
    patches = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    x, y = np.rint(xy).astype(np.int64).T
    angles = np.empty(len(xy), dtype=np.float32)
    for block in range(0, len(xy), 4096):
        rows = slice(block, block + 4096)
        m10, m01 = (
            patches[y[rows], x[rows]].reshape(-1, side * side).astype(np.float32) @ moments
        ).T
        angles[rows] = np.rad2deg(np.arctan2(m01, m10)) % 360
    return angles
