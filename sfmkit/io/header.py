"""Headers of photographs: size and metadata without pixels."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import PIL.Image

from ..errors import ImageError
from .exif import Exif, read_exif
from .images import FORMATS, MAX_PIXELS, READABLE, no_pillow_limit

__all__ = ["ImageHeader", "read_header"]

_TURNED = (5, 6, 7, 8)  # EXIF orientations whose stored rows are columns


@dataclass(frozen=True)
class ImageHeader:
    """Size and metadata of a photograph.

    Attributes:
        path: Path of the file.
        size_wh: Upright width and height, pixels.
        exif: Metadata of the camera; None if there are none.
    """

    path: Path
    size_wh: tuple[int, int]
    exif: Exif | None

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.path.name

    @property
    def orientation(self) -> int:
        """The EXIF orientation, 1 to 8; 1 if it is missing."""
        return self.exif.orientation if self.exif else 1


def read_header(path: str | os.PathLike) -> ImageHeader:
    """Read the header of a photograph.

    The pixels are not decoded, so damage behind the header is not detected.

    Raises:
        ImageError: The file is not an image of a known kind, or larger than 500 megapixels.
    """
    path = Path(path)
    try:
        with (
            warnings.catch_warnings(),
            no_pillow_limit(),
            PIL.Image.open(path, formats=FORMATS) as picture,
        ):
            warnings.simplefilter("ignore")
            exif = read_exif(picture)
            w, h = picture.size
            stored_upright = picture.format == "TIFF"  # Pillow gives the upright size
    except Exception as error:  # Pillow raises almost anything on damaged files
        raise ImageError(f"{path} cannot be read as an image ({error}); {READABLE}") from None
    if not 0 < w * h <= MAX_PIXELS:
        raise ImageError(f"{path} has {w} x {h} pixels; at most {MAX_PIXELS // 10**6} megapixels")
    turned = exif is not None and exif.orientation in _TURNED and not stored_upright
    return ImageHeader(path, (h, w) if turned else (w, h), exif)
