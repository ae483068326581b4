"""Adaptation of given intrinsics to the size and the orientation of an image.

The principal point of intrinsics without a size shows whether they refer to an image of another
size, or to the stored pixels before they were turned upright.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._utils.notices import warn
from ..errors import CameraError
from ..types import Camera
from .calibration import FORMS, Calibration, number, parse_numbers, read_calibration
from .cameras import CameraWarning, centred_camera, same_shape

OFF_CENTRE = 0.06  # largest offset of the principal point of a real lens over a side
_SCALED = 0.1  # smallest change of size that the principal point shows
_PROPORTION = 0.04  # tolerance of the proportion of its two coordinates
_TURNED = 0.002  # offset over the longest side that shows a turn by 180 degrees
_SQUARE = (0.9, 1.1)  # range of fy / fx of square pixels
_ANAMORPHIC = (0.5, 2.0)  # possible range of fy / fx
_SKEW = 0.05  # largest skew over the focal length
_BENT = 0.5  # unusual displacement by distortion over the distance from the centre
_ANGLE = (0.1, 50)  # focal length over the longest side: 157 to 1.1 degrees


def parse_intrinsics(
    text: str | os.PathLike, size_wh: tuple[int, int], *, orientation: int = 1
) -> Camera:
    """Parse intrinsics for an image of `size_wh` pixels.

    Args:
        text: One of

            - ``fx,fy,cx,cy`` with up to five more numbers ``k1,k2,p1,p2,k3``: pixels, the centre of
              the top-left pixel at (0, 0), OpenCV's distortion;
            - ``24mm/36mm``: focal length and width of the sensor along the image's longest side,
              with a central principal point;
            - a file: a 3x3 matrix of numbers separated by spaces, commas or semicolons, in rows or
              on one line, optionally followed by a line of distortion, with comments from ``#`` on;
              one line as above; JSON ``{"K": 3x3, "size_wh": [w, h], "distortion": [...]}``, the
              last two optional; YAML or JSON of OpenCV, ROS (``camera_info``) or Kalibr; the text
              of camera parameters printed by MATLAB; COLMAP's ``cameras.txt``; a ``.camera``
              file of the EPFL data sets. docs/inputs.md has the details.
        size_wh: Upright size of the image, pixels.
        orientation: EXIF orientation by which the image was turned upright
            (:attr:`sfmkit.io.exif.Exif.orientation`). Intrinsics of the stored pixels are turned
            accordingly, with a :class:`~sfmkit.io.cameras.CameraWarning`.

    Returns:
        The camera. Intrinsics with a size are scaled to an image of the same aspect ratio, with a
        warning.

    Raises:
        CameraError: The file is missing, a number is malformed, the size or aspect ratio differs,
            or the intrinsics are impossible.
    """
    text = os.fspath(text).strip()
    millimetres = re.fullmatch(r"([^/]+?)\s*mm\s*/\s*([^/]+?)\s*mm", text)
    if millimetres:
        focal, width = (number(v, text) for v in millimetres.groups())
        if not (focal > 0 and width > 0 and np.isfinite(focal / width)):
            raise CameraError(f"focal length and sensor width must be positive, not {text[:80]}")
        return centred_camera(focal / width * max(size_wh), size_wh, "given")
    if "," in text and not _exists(text):
        calibration = parse_numbers([number(v, text) for v in text.split(",")], text[:200])
    elif not _exists(text):
        raise CameraError(f"there is no file '{text[:200]}'; intrinsics are {FORMS}")
    else:
        calibration = read_calibration(Path(text), size_wh)
    return fit_intrinsics(calibration, size_wh, orientation=orientation, where=text[:200])


def _exists(text: str) -> bool:
    try:
        return os.path.exists(text)
    except ValueError:  # a NUL byte
        return False


def fit_intrinsics(
    calibration: Calibration, size_wh: tuple[int, int], *, orientation: int = 1, where: str = "K"
) -> Camera:
    """Return the camera of a calibration for an image of `size_wh` pixels.

    Args:
        calibration: The calibration.
        size_wh: Upright size of the image, pixels.
        orientation: EXIF orientation by which the image was turned upright.
        where: Name of the calibration in messages.

    Raises:
        CameraError: The intrinsics are impossible, or their size or aspect ratio differs from that
            of the image.
    """
    stored = size_wh[::-1] if orientation >= 5 else size_wh
    if calibration.size_wh is None:
        turn = _belongs_to_stored(calibration.K, size_wh, stored, where)
        calibration = replace(calibration, size_wh=stored if turn else size_wh)
    elif same_shape(calibration.size_wh, size_wh):
        turn = False
    elif same_shape(calibration.size_wh, stored):
        turn = True
    else:
        raise _misfit(calibration.size_wh, size_wh, where)
    camera = calibration.camera(calibration.size_wh or size_wh)
    _judge(camera, where)
    target = stored if turn else size_wh
    if camera.size_wh != target:
        _warn(
            f"{where} is for {camera.size_wh[0]} x {camera.size_wh[1]} pixels; its focal length "
            f"and principal point were scaled to the image's {target[0]} x {target[1]}"
        )
        camera = camera.scaled(target)
    if turn:
        _warn(
            f"{where} belongs to the {stored[0]} x {stored[1]} pixels as stored; it was turned "
            f"with the image (EXIF orientation {orientation})"
        )
        return turned(camera, orientation)
    if 1 < orientation < 5:
        _warn_of_half_turn(camera, orientation, where)
    return camera


def turned(camera: Camera, orientation: int) -> Camera:
    """Convert the camera of the stored pixels to the camera of the upright pixels.

    Args:
        camera: Camera of the stored pixels.
        orientation: EXIF orientation, 1 to 8.

    Raises:
        CameraError: The camera has skew or a tilted sensor, which the turn does not preserve.
    """
    swap = orientation >= 5
    mirror = (-1 if orientation in (2, 3, 6, 7) else 1, -1 if orientation in (3, 4, 7, 8) else 1)
    K, d = camera.K, camera.distortion.copy()
    f, c, size = K[[0, 1], [0, 1]], K[:2, 2], np.array(camera.size_wh)
    if swap and K[0, 1]:
        raise CameraError("K with skew cannot be turned; give K of the upright pixels")
    if len(d) > 12 and d[12:].any():
        raise CameraError("a tilted sensor cannot be turned; give K of the upright pixels")
    if swap:
        f, c, size = f[::-1], c[::-1], size[::-1]
    c = np.where(np.array(mirror) < 0, size - 1 - c, c)
    skew = K[0, 1] * mirror[0] * mirror[1]
    if camera.model == "opencv":  # x' and y' change sides and signs; see OpenCV's calib3d
        p1, p2 = (d[3], d[2]) if swap else (d[2], d[3])
        d[2], d[3] = p1 * mirror[1], p2 * mirror[0]
        if len(d) > 8:
            sx, sy = (d[10:12], d[8:10]) if swap else (d[8:10], d[10:12])
            d[8:12] = [*sx * mirror[0], *sy * mirror[1]]
    return replace(
        camera,
        K=np.array([[f[0], skew, c[0]], [0, f[1], c[1]], [0, 0, 1]]),
        size_wh=(int(size[0]), int(size[1])),
        distortion=d,
    )


def _off_centre(K: np.ndarray, size_wh: tuple[int, int]) -> float:
    """Return the larger offset of the principal point from the centre over the side."""
    size = np.array(size_wh)
    return float((np.abs(K[:2, 2] - (size - 1) / 2) / size).max())


def _belongs_to_stored(
    K: np.ndarray, upright: tuple[int, int], stored: tuple[int, int], where: str
) -> bool:
    """Return whether K without a size refers to the stored pixels.

    Raises:
        CameraError: K refers to an image of another size or orientation.
    """
    if K.shape != (3, 3) or not np.isfinite(K).all():
        return False  # Camera refuses it
    off, w, h = _off_centre(K, upright), *upright
    if off <= OFF_CENTRE:
        return False
    if _off_centre(K, upright[::-1]) < off / 2:
        if stored != upright:
            return True
        raise CameraError(
            f"{where} has its principal point at ({K[0, 2]:g}, {K[1, 2]:g}), the centre of an "
            f"image of {h} x {w} pixels, and this one has {w} x {h}: one of them is rotated; "
            "give K for this image"
        )
    for size, layout in ((upright, "this image"), (stored, "the image as stored")):
        ratio = (K[:2, 2] + 0.5) / (np.array(size) / 2)
        same = abs(ratio[0] / ratio[1] - 1) < _PROPORTION if ratio.min() > 0 else False
        if same and abs(ratio.mean() - 1) > _SCALED:
            w1, h1 = (round(side * float(ratio.mean())) for side in size)
            raise CameraError(
                f"{where} has its principal point at ({K[0, 2]:g}, {K[1, 2]:g}), the centre of an "
                f"image of about {w1} x {h1} pixels, and {layout} has {size[0]} x {size[1]}: is it "
                "another size's K? Scale K to this image, or state its size in a JSON file: "
                '{"K": 3x3, "size_wh": [w, h]}'
            )
    return False


def _misfit(given: tuple[int, int], size_wh: tuple[int, int], where: str) -> CameraError:
    (w, h), (w1, h1) = size_wh, given
    why = (
        "the image is turned"
        if (w < h) != (w1 < h1)
        else "the image is cropped, or the camera is another one"
    )
    return CameraError(
        f"{where} is for {w1} x {h1} pixels and the image has {w} x {h}: {why}; "
        "give K for this image"
    )


def _judge(camera: Camera, where: str) -> None:
    """Raise an error for impossible intrinsics, and warn of unusual ones."""
    (cx, cy), (w, h), fx, fy = camera.K[:2, 2], camera.size_wh, camera.K[0, 0], camera.K[1, 1]
    ratio, skew = fy / fx, abs(camera.K[0, 1]) / fx
    if not _ANAMORPHIC[0] <= ratio <= _ANAMORPHIC[1] or skew > 1:
        raise CameraError(
            f"{where} has focal lengths {fx:g} and {fy:g} and skew {camera.K[0, 1]:g}, which are "
            "not those of one lens: check the order of the numbers, and that decimals have points"
        )
    moved = _moved_at_the_edge(camera)
    if moved > 1:
        k = ", ".join(f"{v:g}" for v in camera.distortion[:5])
        raise CameraError(
            f"{where} has distortion {k}, which moves the edge of the image by {moved:.1f} times "
            "its distance from the centre: check the order k1, k2, p1, p2, k3"
        )
    if _off_centre(camera.K, (w, h)) > OFF_CENTRE:
        doubt = (
            f"the principal point ({cx:g}, {cy:g}) is far from the centre of the {w} x {h} image; "
            "is it another size's K?"
        )
    elif not _ANGLE[0] <= fx / max(w, h) <= _ANGLE[1]:
        doubt = f"the focal length {fx:g} is unusual for a {w} x {h} image; is it in pixels?"
    elif not _SQUARE[0] <= ratio <= _SQUARE[1] or skew > _SKEW:
        doubt = f"pixels with fx {fx:g}, fy {fy:g} and skew {camera.K[0, 1]:g} are unusual"
    elif moved > _BENT:
        doubt = f"the distortion moves the edge of the image by {moved:.0%}, which is unusual"
    else:
        return
    _warn(f"{where}: {doubt}")


def _moved_at_the_edge(camera: Camera) -> float:
    """Return the radial displacement at the middle of the farther edge over its distance."""
    if camera.model != "opencv":
        return 0.0
    s = (max(camera.size_wh) / 2 / camera.K[0, 0]) ** 2
    d = np.zeros(8)
    d[: min(8, len(camera.distortion))] = camera.distortion[:8]
    radial = (1 + s * (d[0] + s * (d[1] + s * d[4]))) / (1 + s * (d[5] + s * (d[6] + s * d[7])))
    return abs(float(radial) - 1) if np.isfinite(radial) else float("inf")


def _warn_of_half_turn(camera: Camera, orientation: int, where: str) -> None:
    other = turned(camera, orientation).K[:2, 2]
    if np.abs(other - camera.K[:2, 2]).max() > _TURNED * max(camera.size_wh):
        _warn(
            f"the image was turned by its EXIF orientation {orientation}; {where} is taken as that "
            f"of the upright pixels. If it belongs to the pixels as stored, the principal point is "
            f"({other[0]:g}, {other[1]:g})"
        )


def _warn(text: str) -> None:
    warn(text, CameraWarning, stacklevel=4)
