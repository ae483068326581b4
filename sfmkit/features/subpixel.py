"""Sub-pixel refinement of corners with a paraboloid through the detector's response.

The response must be that of the detector. Another response (for example Harris around FAST corners)
has its maximum elsewhere and makes positions worse, as ``cv2.cornerSubPix`` does; see
docs/benchmarks.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np

_AROUND_Y, _AROUND_X = np.mgrid[-1:2, -1:2]

# Bresenham circle of radius 3, in order (Rosten & Drummond 2006, fig. 1).
_CIRCLE_X = np.array([0, 1, 2, 3, 3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1])
_CIRCLE_Y = np.array([3, 3, 2, 1, 0, -1, -2, -3, -3, -3, -2, -1, 0, 1, 2, 3])
_ARC = 9

Response = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def fast_score(grey: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute the FAST-9 score at whole pixels at least 3 pixels inside the image.

    The score is the largest threshold by which 9 contiguous pixels of the circle are all brighter,
    or all darker, than the centre (Rosten & Drummond 2006). ``cv2.FastFeatureDetector`` reports
    this number minus 1.

    Args:
        grey: (H, W) uint8 image.
        x, y: Integer arrays of one shape.

    Returns:
        An int16 array of that shape; not positive where the pixel is not a corner at any threshold.
    """
    flat, at = grey.reshape(-1), y * grey.shape[1] + x
    centre = flat[at].astype(np.int16)
    ring = (
        np.stack([flat[at + (dy * grey.shape[1] + dx)] for dx, dy in zip(_CIRCLE_X, _CIRCLE_Y)])
        - centre
    )
    return np.maximum(_best_arc(ring), _best_arc(-ring))


def _best_arc(ring: np.ndarray) -> np.ndarray:
    """Find the largest minimum of all arcs of 9 of the 16 values along axis 0."""
    ring = np.concatenate([ring, ring[: _ARC - 1]])
    two = np.minimum(ring[:-1], ring[1:])
    four = np.minimum(two[:-2], two[2:])
    eight = np.minimum(four[:-4], four[4:])
    return np.minimum(eight[:-1], ring[_ARC - 1 :]).max(axis=0)


def paraboloid_top(r: np.ndarray) -> np.ndarray:
    """Find the maximum of the least-squares paraboloid through 3 x 3 values.

    Args:
        r: (3, 3, N) values, rows (y) first.

    Returns:
        (N, 2) offsets x, y from the middle, clamped to [-1/2, 1/2]; 0 without a maximum.
    """
    g_x, g_y = (r[:, 2] - r[:, 0]).sum(axis=0) / 6, (r[2] - r[0]).sum(axis=0) / 6
    h_xx = (r[:, 0] - 2 * r[:, 1] + r[:, 2]).sum(axis=0) / 3
    h_yy = (r[0] - 2 * r[1] + r[2]).sum(axis=0) / 3
    h_xy = (r[0, 0] - r[0, 2] - r[2, 0] + r[2, 2]) / 4
    det = h_xx * h_yy - h_xy**2
    top = np.zeros((r.shape[2], 2))
    peak = (det > 0) & (h_xx < 0)
    np.divide(h_xy * g_y - h_yy * g_x, det, out=top[:, 0], where=peak)
    np.divide(h_xy * g_x - h_xx * g_y, det, out=top[:, 1], where=peak)
    return np.clip(top, -0.5, 0.5)


def refine(
    grey: np.ndarray, xy: np.ndarray, detector: str, options: dict[str, Any], octave: np.ndarray
) -> np.ndarray:
    """Refine the positions of whole-pixel corners to a fraction of a pixel.

    Args:
        grey: (H, W) uint8 image.
        xy: (N, 2) positions from OpenCV.
        detector: ``fast``, ``agast``, ``orb``, ``gftt`` or ``harris``.
        options: Options of the detector.
        octave: (N,) pyramid level of each keypoint; used only for ORB.

    Returns:
        (N, 2) float64 positions. Positions of ORB are also corrected for the true sizes of the
        pyramid levels: OpenCV multiplies level coordinates by the nominal scale, which causes
        errors of up to 2 pixels.
    """
    if detector == "orb":
        return _refine_pyramid(grey, xy, octave, options)
    response: Response = fast_score
    if detector in ("gftt", "harris"):
        block = options["blockSize"]
        if detector == "harris":
            field = cv2.cornerHarris(grey, block, 3, options["k"])
        else:
            field = cv2.cornerMinEigenVal(grey, block, ksize=3)

        def response(_: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return field[y, x]

    return xy + _offset(grey, xy, response)


def _offset(grey: np.ndarray, xy: np.ndarray, response: Response, margin: int = 4) -> np.ndarray:
    """Compute offsets (N, 2) to the maximum of the response; 0 within `margin` of the border."""
    h, w = grey.shape
    offset = np.zeros((len(xy), 2))
    cell = np.rint(xy).astype(np.int64)
    inside = np.flatnonzero(((cell >= margin) & (cell < (w - margin, h - margin))).all(axis=1))
    if len(inside):
        x, y = cell[inside].T
        r = response(grey, x + _AROUND_X[..., None], y + _AROUND_Y[..., None])
        offset[inside] = paraboloid_top(r.astype(np.float64))
    return offset


def _pyramid(
    grey: np.ndarray, scale_factor: float, levels: int
) -> Iterator[tuple[int, float, np.ndarray]]:
    """Yield the number, nominal scale and image of each level of ORB's pyramid.

    Each level is resized from the previous level.
    """
    h, w = grey.shape
    for level in range(levels):
        scale = scale_factor**level
        size = (round(w / scale), round(h / scale))
        if min(size) < 1:
            return
        if level:
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR_EXACT)
        yield level, scale, grey


def _refine_pyramid(
    grey: np.ndarray, xy: np.ndarray, octave: np.ndarray, options: dict[str, Any]
) -> np.ndarray:
    refined = xy.astype(np.float64)
    full = np.array(grey.shape[::-1], dtype=np.float64)
    for level, scale, image in _pyramid(grey, options["scaleFactor"], options["nlevels"]):
        at = np.flatnonzero(octave == level)
        if len(at):
            xy_level = refined[at] / scale
            xy_level += _offset(image, xy_level, fast_score)
            refined[at] = (xy_level + 0.5) * full / image.shape[::-1] - 0.5
    return refined
