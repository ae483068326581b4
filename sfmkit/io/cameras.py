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
GUESSED_FOCAL = 1.2  # in longest sides: 45 degrees across, between a phone's and a normal lens
AGREEMENT = 1.1  # ratio of two focal lengths that agree: the tags are rounded and nominal
_ANGLE = (0.1, 50)  # focal length in longest sides: 157 degrees to 1.1 degrees across
_ADVICE = "Give the camera (--intrinsics)"


class CameraWarning(UserWarning):
    """A camera had to be guessed or adapted; results depend on it."""


@dataclass(frozen=True)
class FocalSource:
    """What one source says about the focal length.

    Attributes:
        name: of the source.
        focal: pixels of the image.
        survives_resizing: whether the number does not depend on the size of the picture.
    """

    name: str
    focal: float
    survives_resizing: bool = True


def camera_from_exif(image: Image | ImageHeader) -> Camera:
    """Return the camera of a photograph from its metadata.

    Square pixels, the principal point in the centre, no distortion. The sources of the focal length
    are compared. In order of precision:

    1. the calibrated focal length in pixels that DJI drones write (XMP);
    2. focal length in mm and resolution of the focal plane (FocalPlaneXResolution);
    3. the 35 mm equivalent, taken against the diagonal of the frame (43.27 mm, as CIPA DCG-001
       defines it): cameras of 3:2 have the same focal length either way, for those of 4:3 the width
       (36 mm) would give 4 % less;
    4. focal length in mm and the sensor's width from :mod:`sfmkit.io.sensors`;
    5. a guess, 1.2 times the longest side, with a :class:`CameraWarning` and
       ``Camera.source == "guessed"``.

    Of sources that agree to 10 % the most precise one is taken. Where they disagree, the largest
    group that agrees is taken; of two groups of one size the one that does not rest on a number in
    pixels, because editors that resize a photograph keep the numbers of the full size. A
    :class:`CameraWarning` then lists them all, and ``Camera.sigma`` holds the disagreement.

    A digital zoom multiplies the focal length of the lens; the 35 mm equivalent may include it or
    not, and the reading that agrees with the other sources is taken.

    Where EXIF states the size at which the photograph was taken, the focal length is scaled with
    the image's longest side: a resized photograph keeps its angle of view.
    """
    w, h = image.size_wh
    exif = image.exif or Exif()
    sources = [s for s in _sources(exif, image) if _ANGLE[0] <= s.focal / max(w, h) <= _ANGLE[1]]
    if not sources:
        focal = GUESSED_FOCAL * max(w, h)
        _warn(
            f"the focal length of {image.name} is GUESSED as {focal:.0f} px ({GUESSED_FOCAL} x the "
            "longest side): the metadata have none; pose and cloud are as wrong as this guess. "
            f"{_ADVICE}"
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
    """The largest group of sources that agree with one of them, in order of precision."""
    groups = [
        [s for s in sources if max(s.focal, c.focal) <= AGREEMENT * min(s.focal, c.focal)]
        for c in sources
    ]
    return max(groups, key=lambda group: (len(group), any(s.survives_resizing for s in group)))


def _sources(exif: Exif, image: Image | ImageHeader) -> list[FocalSource]:
    """The sources of the focal length, the most precise first; in pixels of the image."""
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
    """The size at which the photograph was taken, where EXIF has it, else the image's own; in
    either order."""
    if exif.size_wh is None:
        return image.size_wh
    # Some software swaps the two numbers, so only their ratio counts.
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
    """Warn where nothing shows whether numbers in pixels belong to this size."""
    if exif.size_wh is None and not any(s.survives_resizing for s in sources):
        _warn(
            f"the focal length of {image.name} is {chosen.focal:.0f} px from its {chosen.name}, "
            "which is wrong if the photograph was resized: EXIF has neither the size at which it "
            f"was taken nor a 35 mm equivalent to compare with. {_ADVICE}"
        )


def same_shape(size1: Any, size2: Any) -> bool:
    """Whether two sizes have one aspect ratio, to 1 % or the rounding of a pixel."""
    (w1, h1), (w2, h2) = size1, size2
    return abs(w1 * h2 - w2 * h1) <= max(0.01 * w1 * h2, w1, h1, w2, h2)


def centred_camera(focal: float, size_wh: tuple[int, int], source: str) -> Camera:
    """Return a camera with square pixels and the principal point in the centre."""
    w, h = size_wh
    K = np.array([[focal, 0, (w - 1) / 2], [0, focal, (h - 1) / 2], [0, 0, 1]])
    return Camera(K, size_wh, source=source)


def _warn(text: str) -> None:
    warn(text, CameraWarning, stacklevel=4)
