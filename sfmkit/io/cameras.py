"""Cameras from EXIF and XMP."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._utils.notices import warn
from ..types import Camera, IntrinsicsSigma
from .exif import Exif
from .header import ImageHeader
from .images import Image
from .sensors import sensor_width

FILM_DIAGONAL_MM = math.hypot(36, 24)  # the 35 mm film frame
GUESSED_FOCAL = 1.2  # times the longest side: 45 degrees, between a phone and a normal lens
AGREEMENT = 1.1  # largest ratio of agreeing focal lengths; the tags are rounded and nominal
_ANGLE = (0.1, 50)  # focal length over the longest side: 157 to 1.1 degrees
_ADVICE = "Give the camera (--intrinsics)"


class CameraWarning(UserWarning):
    """Warning: a camera was guessed or adapted, and results depend on it."""


@dataclass(frozen=True)
class FocalSource:
    """The focal length according to one source.

    Attributes:
        name: Name of the source.
        focal: Focal length in pixels of the image.
        survives_resizing: Whether the value remains valid if the photograph is resized.
    """

    name: str
    focal: float
    survives_resizing: bool = True


def camera_from_exif(image: Image | ImageHeader) -> Camera:
    """Return the camera of a photograph from its metadata.

    The camera has square pixels, a central principal point and no distortion. The sources of the
    focal length are compared. In order of precision, they are:

    1. the calibrated focal length in pixels of DJI drones (XMP);
    2. the focal length in mm and the resolution of the focal plane (FocalPlaneXResolution);
    3. the 35 mm equivalent with respect to the diagonal of the frame (43.27 mm, definition of CIPA
       DCG-001); for images of 3:2 the width (36 mm) gives the same focal length, for images of 4:3
       it would give 4 % less;
    4. the focal length in mm and the sensor width from :mod:`sfmkit.io.sensors`;
    5. a guess, 1.2 times the longest side, with a :class:`CameraWarning` and
       ``Camera.source == "guessed"``.

    Sources agree if they differ by at most 10 %. The most precise source of the largest group of
    agreeing sources is used. Of two groups of equal size, the one without values in pixels is
    preferred, because editors that resize a photograph keep the values of the full size. If sources
    disagree, a :class:`CameraWarning` lists all of them, and ``Camera.sigma`` contains the
    disagreement.

    A digital zoom multiplies the focal length of the lens. The 35 mm equivalent may or may not
    include it; the interpretation that agrees with the other sources is used.

    If EXIF contains the original size of the photograph, the focal length is scaled with the
    longest side of the image, because a resized photograph keeps its angle of view.
    """
    w, h = image.size_wh
    exif = image.exif or Exif()
    sources = [s for s in _sources(exif, image) if _ANGLE[0] <= s.focal / max(w, h) <= _ANGLE[1]]
    if not sources:
        focal = GUESSED_FOCAL * max(w, h)
        _warn(
            f"the focal length of {image.name} is GUESSED as {focal:.0f} px ({GUESSED_FOCAL} x the "
            "longest side): the metadata have none; pose and cloud are as wrong as this guess, "
            f"unless the matches determine the focal length. {_ADVICE}"
        )
        return centred_camera(focal, image.size_wh, "guessed")
    group = _largest_group(sources)
    chosen, others = group[0], [s for s in sources if s not in group]
    camera = centred_camera(chosen.focal, image.size_wh, f"exif: {chosen.name}")
    if not others:
        _warn_of_unknown_size(chosen, sources, exif, image)
        return camera
    listed = "; ".join(f"{s.name} {s.focal:.0f} px" for s in sources)
    _warn(
        f"the metadata of {image.name} disagree about the focal length: {listed}. "
        f"{chosen.focal:.0f} px were taken. Was the photograph resized, cropped or zoomed "
        f"digitally? {_ADVICE}"
    )
    doubt = max(abs(math.log(s.focal / chosen.focal)) for s in others)
    certain = len(group) > len(others) and len(group) > 1
    focal = camera.uncertainty.focal if certain else max(camera.uncertainty.focal, doubt / 2)
    default = camera.uncertainty
    sigma = IntrinsicsSigma(min(focal, 1.0), default.principal_point, default.k1)
    source = f"{camera.source}; {', '.join(s.name for s in others)} disagrees"
    return Camera(camera.K, camera.size_wh, source=source, sigma=sigma)


def _largest_group(sources: list[FocalSource]) -> list[FocalSource]:
    """Return the largest group of sources that agree with one source, in order of precision."""
    groups = [
        [s for s in sources if max(s.focal, c.focal) <= AGREEMENT * min(s.focal, c.focal)]
        for c in sources
    ]
    return max(groups, key=lambda group: (len(group), any(s.survives_resizing for s in group)))


def _sources(exif: Exif, image: Image | ImageHeader) -> list[FocalSource]:
    """List the sources of the focal length in order of precision, in pixels of the image."""
    taken = _taken_size(exif, image)
    scale = max(image.size_wh) / max(taken)
    zoom = exif.digital_zoom or 1.0
    found = []
    if exif.calibrated_focal_px:
        focal = exif.calibrated_focal_px * zoom * scale
        found.append(FocalSource("calibrated focal length of the drone", focal, False))
    if exif.focal_mm and exif.focal_plane_resolution:
        focal = exif.focal_mm * exif.focal_plane_resolution[0] * zoom * scale
        found.append(FocalSource("focal plane resolution", focal, False))
    width = sensor_width(exif.make, exif.model)
    sensor = None
    if exif.focal_mm and width:
        name = f"{exif.focal_mm:g} mm on the {width:g} mm wide sensor of {exif.model}"
        sensor = FocalSource(name, exif.focal_mm / width * zoom * max(image.size_wh))
    if exif.focal_35mm:
        name = f"{exif.focal_35mm:g} mm equivalent, by the diagonal"
        focal = exif.focal_35mm / FILM_DIAGONAL_MM * math.hypot(*image.size_wh)
        others = [s.focal for s in (sensor, *found) if s]
        if zoom > 1 and any(_nearer(focal * zoom, focal, other) for other in others[:1]):
            name, focal = f"{name}, times the digital zoom of {zoom:g}", focal * zoom
        found.append(FocalSource(name, focal))
    return [*found, sensor] if sensor else found


def _nearer(one: float, two: float, to: float) -> bool:
    return abs(math.log(one / to)) < abs(math.log(two / to))


def _taken_size(exif: Exif, image: Image | ImageHeader) -> tuple[int, int]:
    """Return the original size of the photograph from EXIF, or the size of the image.

    Width and height may be swapped.
    """
    if exif.size_wh is None:
        return image.size_wh
    # Some programs swap the two numbers, so only their ratio is used.
    if not same_shape(tuple(sorted(exif.size_wh)), tuple(sorted(image.size_wh))):
        (w, h), (w1, h1) = image.size_wh, exif.size_wh
        _warn(
            f"{image.name} was cropped: it has {w} x {h} pixels and EXIF says {w1} x {h1}. "
            f"The camera from EXIF may be wrong. {_ADVICE}"
        )
    return exif.size_wh


def _warn_of_unknown_size(
    chosen: FocalSource, sources: list[FocalSource], exif: Exif, image: Image | ImageHeader
) -> None:
    """Warn if it is unknown whether values in pixels refer to the size of this image."""
    if exif.size_wh is None and not any(s.survives_resizing for s in sources):
        _warn(
            f"the focal length of {image.name} is {chosen.focal:.0f} px from its {chosen.name}, "
            "which is wrong if the photograph was resized: EXIF has neither the size at which it "
            f"was taken nor a 35 mm equivalent to compare with. {_ADVICE}"
        )


def same_shape(size1: Any, size2: Any) -> bool:
    """Return whether two sizes have the same aspect ratio, up to 1 % or rounding to pixels."""
    (w1, h1), (w2, h2) = size1, size2
    return abs(w1 * h2 - w2 * h1) <= max(0.01 * w1 * h2, w1, h1, w2, h2)


def centred_camera(focal: float, size_wh: tuple[int, int], source: str) -> Camera:
    """Return a camera with square pixels and the principal point in the centre."""
    w, h = size_wh
    K = np.array([[focal, 0, (w - 1) / 2], [0, focal, (h - 1) / 2], [0, 0, 1]])
    return Camera(K, size_wh, source=source)


def _warn(text: str) -> None:
    warn(text, CameraWarning, stacklevel=4)
