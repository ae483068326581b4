"""Metadata of a photograph: EXIF tags, and XMP properties of drones."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import PIL.Image

# Numbers of the tags of EXIF 2.32 (CIPA DC-008).
_MAKE, _MODEL, _ORIENTATION, _EXIF_IFD = 0x010F, 0x0110, 0x0112, 0x8769
_FOCAL_MM, _FOCAL_35MM, _DIGITAL_ZOOM = 0x920A, 0xA405, 0xA404
_PLANE_X, _PLANE_Y, _PLANE_UNIT = 0xA20E, 0xA20F, 0xA210
_SIZE_X, _SIZE_Y = 0xA002, 0xA003
_GPS_IFD = 0x8825
_LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE, _ALTITUDE_REF, _ALTITUDE = range(1, 7)
_UNIT_MM = {3: 10.0, 4: 1.0, 5: 0.001}  # every other value of the unit tag means inches
_MAX_SIDE = 1_000_000  # pixels; a larger size is a damaged tag
_XMP_BYTES = 1_000_000  # searched part of an XMP packet; real packets have some kilobytes


@dataclass(frozen=True)
class Exif:
    """Metadata of the camera; None for missing values.

    Zero, NaN and unreadable values count as missing.

    Attributes:
        make, model: Manufacturer and model of the camera.
        orientation: Orientation in the file, 1 to 8 (EXIF 2.32, tag 0x0112); the pixels of an
            :class:`~sfmkit.io.images.Image` are already upright.
        focal_mm: Focal length, mm.
        focal_35mm: Focal length of a 35 mm film camera with the same angle of view, integer mm.
        focal_plane_resolution: Pixels per mm on the sensor along the stored x and y.
        digital_zoom: Digital zoom ratio, at least 1.
        size_wh: Width and height at the time of capture, pixels (PixelXDimension and
            PixelYDimension); different from the size of the file if the photograph was resized.
        stored_wh: Width and height of the stored pixels, before they were turned upright.
        calibrated_focal_px: Focal length in pixels of the original photograph, from the factory
            calibration of a drone (XMP ``drone-dji:CalibratedFocalLength``).
        relative_altitude_m: Height above the take-off point, metres (XMP
            ``drone-dji:RelativeAltitude``).
        position: Latitude and longitude, degrees, north and east positive (WGS 84), and altitude,
            metres; a missing altitude is NaN.
        gimbal_deg: Yaw, pitch and roll of the gimbal, degrees (XMP ``drone-dji:Gimbal...Degree``).
    """

    make: str | None = None
    model: str | None = None
    orientation: int = 1
    focal_mm: float | None = None
    focal_35mm: float | None = None
    focal_plane_resolution: tuple[float, float] | None = None
    digital_zoom: float | None = None
    size_wh: tuple[int, int] | None = None
    stored_wh: tuple[int, int] | None = None
    calibrated_focal_px: float | None = None
    relative_altitude_m: float | None = None
    gimbal_deg: tuple[float, float, float] | None = None
    position: tuple[float, float, float] | None = None


def read_exif(picture: PIL.Image.Image) -> Exif | None:
    """Read the metadata of a picture whose pixels have not been loaded.

    The readable values of a damaged block are used; a damaged block is not an error.

    Returns:
        The metadata; None if the file has neither EXIF nor XMP.
    """
    tags, xmp = _tags(picture), _xmp(picture)
    if not tags and not xmp:
        return None
    orientation = int(_positive(tags, _ORIENTATION, 1))
    orientation = orientation if 1 <= orientation <= 8 else 1
    unit_mm = _UNIT_MM.get(int(_positive(tags, _PLANE_UNIT, 2)), 25.4)
    resolution = _pair(_positive(tags, _PLANE_X), _positive(tags, _PLANE_Y))
    size = _pair(_positive(tags, _SIZE_X), _positive(tags, _SIZE_Y))
    if size and max(size) > _MAX_SIDE:
        size = None
    zoom = _positive(tags, _DIGITAL_ZOOM)
    gimbal = [_dji(xmp, f"Gimbal{axis}Degree") for axis in ("Yaw", "Pitch", "Roll")]
    calibrated = _dji(xmp, "CalibratedFocalLength")
    return Exif(
        make=_text(tags, _MAKE),
        model=_text(tags, _MODEL),
        orientation=orientation,
        focal_mm=_positive(tags, _FOCAL_MM) or None,
        focal_35mm=_positive(tags, _FOCAL_35MM) or None,
        focal_plane_resolution=resolution and (resolution[0] / unit_mm, resolution[1] / unit_mm),
        digital_zoom=zoom if zoom >= 1 else None,
        size_wh=size and (int(size[0]), int(size[1])),
        stored_wh=_stored_size(picture, orientation),
        calibrated_focal_px=calibrated if calibrated and calibrated > 0 else None,
        relative_altitude_m=_dji(xmp, "RelativeAltitude"),
        gimbal_deg=None if None in gimbal else tuple(gimbal),  # type: ignore[arg-type]
        position=_position(picture),
    )


def _position(picture: PIL.Image.Image) -> tuple[float, float, float] | None:
    """Read the position from the GPS tags; a missing altitude is NaN."""
    try:
        tags = picture.getexif().get_ifd(_GPS_IFD)
        angles = []
        for value, reference, south_or_west, most in (
            (_LATITUDE, _LATITUDE_REF, "S", 90.0),
            (_LONGITUDE, _LONGITUDE_REF, "W", 180.0),
        ):
            degrees, minutes, seconds = (float(v) for v in tags[value])
            angle = degrees + minutes / 60 + seconds / 3600
            if not abs(angle) <= most:
                return None
            angles.append(-angle if str(tags.get(reference)).startswith(south_or_west) else angle)
    except Exception:  # Pillow's parser raises almost anything on damaged blocks
        return None
    if angles == [0.0, 0.0]:  # written by receivers without a fix
        return None
    altitude = math.nan
    with suppress(Exception):
        below = tags.get(_ALTITUDE_REF, b"\0") in (1, b"\1")
        altitude = float(tags[_ALTITUDE]) * (-1 if below else 1)
    return (angles[0], angles[1], altitude)


def _stored_size(picture: PIL.Image.Image, orientation: int) -> tuple[int, int]:
    """Return the size of the stored pixels; Pillow returns the upright size for TIFF."""
    w, h = picture.size
    return (h, w) if picture.format == "TIFF" and orientation >= 5 else (w, h)


def _tags(picture: PIL.Image.Image) -> Mapping[int, Any]:
    try:
        exif = picture.getexif()
        tags: dict[int, Any] = dict(exif)
        return tags | exif.get_ifd(_EXIF_IFD) if tags else tags
    except Exception:  # Pillow's parser raises almost anything on damaged blocks
        return {}


def _xmp(picture: PIL.Image.Image) -> str:
    packet = picture.info.get("xmp") or b""
    if isinstance(packet, tuple):  # TIFF may hold it as numbers
        packet = bytes(v & 0xFF for v in packet[:_XMP_BYTES] if isinstance(v, int))
    if isinstance(packet, str):
        return packet[:_XMP_BYTES]
    return packet[:_XMP_BYTES].decode("utf-8", "replace") if isinstance(packet, bytes) else ""


def _dji(xmp: str, name: str) -> float | None:
    """Read the number of the XMP property ``drone-dji:NAME``, an attribute or an element."""
    found = re.search(rf'drone-dji:{name}\s*(?:=\s*"|>)\s*([-+]?[0-9.]{{1,20}})\s*["<]', xmp)
    try:
        return float(found[1]) if found else None
    except ValueError:
        return None


def _positive(tags: Mapping[int, Any], tag: int, otherwise: float = 0.0) -> float:
    """Return the tag as a positive finite number, or `otherwise`."""
    try:
        value = float(tags[tag])
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError):
        return otherwise
    return value if math.isfinite(value) and value > 0 else otherwise


def _text(tags: Mapping[int, Any], tag: int) -> str | None:
    value = tags.get(tag)
    return value.split("\0")[0].strip() or None if isinstance(value, str) else None


def _pair(x: float, y: float) -> tuple[float, float] | None:
    return (x, y) if x and y else None
