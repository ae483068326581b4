"""Photographs into memory: decoded, upright, 8 bit, with what EXIF says about the camera."""

from __future__ import annotations

import io
import math
import os
import threading
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
from PIL import UnidentifiedImageError

from ..errors import ImageError

MAX_PIXELS = 500_000_000  # 2 GB decoded; a file that claims more is damaged or hostile
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm", ".gif")

_pillow_limit = threading.Lock()  # Pillow's own pixel limit is a global of its module


@dataclass(frozen=True)
class Exif:
    """What EXIF says about the camera; None where it says nothing (zero, NaN and rubbish count as
    nothing).

    Attributes:
        make, model: of the camera.
        orientation: 1 to 8 as it was in the file (EXIF 2.32, tag 0x0112); the pixels have been
            turned upright since.
        focal_mm: focal length, mm.
        focal_35mm: focal length of a 35 mm film camera with the same angle of view, mm; whole
            numbers only.
        focal_plane_resolution: pixels per mm on the sensor along the stored x and y.
        size_wh: width and height in pixels when the photograph was taken; differs from the file's
            when it was resized.
        stored_wh: width and height of the pixels as stored, before they were turned upright.
    """

    make: str | None = None
    model: str | None = None
    orientation: int = 1
    focal_mm: float | None = None
    focal_35mm: float | None = None
    focal_plane_resolution: tuple[float, float] | None = None
    size_wh: tuple[int, int] | None = None
    stored_wh: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Image:
    """An upright photograph.

    Attributes:
        rgb: (H, W, 3) uint8.
        grey: (H, W) uint8, ``0.299 R + 0.587 G + 0.114 B`` (ITU-R BT.601) rounded, as
            ``cv2.cvtColor`` has it.
        path: the file it came from, None for an array.
        exif: what the file says about the camera, None for an array or a file without EXIF.
    """

    rgb: np.ndarray
    grey: np.ndarray
    path: Path | None = None
    exif: Exif | None = None

    def __post_init__(self) -> None:
        shape = self.rgb.shape
        if len(shape) != 3 or shape[2] != 3 or self.rgb.dtype != np.uint8 or 0 in shape:
            raise ImageError(f"Image.rgb must be (H, W, 3) uint8, not {shape} {self.rgb.dtype}")
        if self.grey.shape != shape[:2] or self.grey.dtype != np.uint8:
            raise ImageError(
                f"Image.grey must be {shape[:2]} uint8, not {self.grey.shape} {self.grey.dtype}"
            )

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height in pixels, upright."""
        return self.rgb.shape[1], self.rgb.shape[0]

    @property
    def name(self) -> str:
        """The file's name, or ``array``."""
        return self.path.name if self.path else "array"

    def __repr__(self) -> str:
        return f"Image({self.name}, {self.size_wh[0]} x {self.size_wh[1]})"


def read_image(source: str | os.PathLike | np.ndarray | Image) -> Image:
    """Read a photograph from a file, or take one from an array.

    Files may be 8 or 16 bit, RGB, grey, palette or CMYK, with or without alpha; of several frames
    the first is read. 16-bit values keep their high byte (``v >> 8``). Alpha is dropped: the stored
    colours are used, so that no edge is invented where the picture becomes transparent. The EXIF
    orientation is applied: sizes are upright sizes.

    Args:
        source: a path; or an array (H, W), (H, W, 1), (H, W, 3) RGB or (H, W, 4) RGBA of uint8,
            uint16 or floats in [0, 1]; or an :class:`Image`, which comes back as it is.

    Raises:
        ImageError: no such file, a folder, an empty, damaged, cut-off or unknown file, more than
            500 megapixels, or an array of another kind.
    """
    if isinstance(source, Image):
        return source
    if isinstance(source, (str, os.PathLike)):
        return _read_file(Path(source))
    if isinstance(source, np.ndarray):
        return _image(_to_8bit(source, "the array"))
    raise ImageError(f"an image is a path or a NumPy array, not {type(source).__name__}")


def _image(pixels: np.ndarray, path: Path | None = None, exif: Exif | None = None) -> Image:
    """The image of (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) uint8 pixels."""
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        grey = np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
        return Image(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), grey, path, exif)
    rgb = np.ascontiguousarray(pixels[..., :3])
    return Image(rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), path, exif)


def _to_8bit(pixels: np.ndarray, what: str) -> np.ndarray:
    """Check shape and dtype of `pixels` and bring their values to uint8."""
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] not in (1, 3, 4)):
        raise ImageError(
            f"{what} must have shape (H, W), (H, W, 3) or (H, W, 4), not {pixels.shape}"
        )
    if 0 in pixels.shape:
        raise ImageError(f"{what} has no pixels: its shape is {pixels.shape}")
    if pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        raise ImageError(_too_large(what, pixels.shape[1], pixels.shape[0]))
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype == np.uint16:
        return (pixels >> 8).astype(np.uint8)
    if pixels.dtype.kind == "f":
        if not np.isfinite(pixels).all():
            raise ImageError(f"{what} holds NaN or infinite values")
        low, high = float(pixels.min()), float(pixels.max())
        if low < 0 or high > 1:
            raise ImageError(
                f"{what} of floats must lie in [0, 1], not in [{low:g}, {high:g}]; scale it or use uint8"
            )
        return np.rint(pixels * 255).astype(np.uint8)
    raise ImageError(f"{what} must be uint8, uint16 or floats in [0, 1], not {pixels.dtype}")


def _read_file(path: Path) -> Image:
    return decode_image(_read_bytes(path), path)


def decode_image(data: bytes, path: Path) -> Image:
    """:func:`read_image` of a file's bytes, which came from elsewhere; `path` is what to call it.

    Raises:
        ImageError: as there.
    """
    try:
        with _open(data, path) as picture:
            exif = _read_exif(picture)
            pixels = _decode(picture, data, path)
    except (
        OSError,
        SyntaxError,
        ValueError,
        EOFError,
        MemoryError,
        PIL.Image.DecompressionBombError,
    ) as error:
        if isinstance(error, ImageError):
            raise
        if "truncated" in str(error).lower() or isinstance(error, EOFError):
            raise ImageError(
                f"{path} is truncated: it ends before the picture does; fetch it again"
            ) from error
        raise ImageError(
            f"{path} cannot be decoded ({error}): it is damaged or of an unsupported kind"
        ) from error
    if exif is not None:
        pixels = _upright(pixels, exif.orientation)
    return _image(pixels, path, exif)


def _read_bytes(path: Path) -> bytes:
    """The file's bytes, or an ImageError that says what stands in their place."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ImageError(f"there is no file {path}.{_near_names(path)}") from None
    except IsADirectoryError:
        inside = sorted(p.name for p in path.iterdir() if p.suffix.lower() in SUFFIXES)
        hint = (
            f"; name one of its {len(inside)} images, e.g. {path / inside[0]}"
            if inside
            else " without images"
        )
        raise ImageError(f"{path} is a directory{hint}") from None
    except (
        OSError,
        ValueError,
    ) as error:  # no permission; a name with a NUL byte; a path below a file
        raise ImageError(
            f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    if not data:
        raise ImageError(f"{path} is empty (0 bytes)")
    return data


def _near_names(path: Path) -> str:
    """A hint at what the missing `path` may have meant."""
    folder = path.parent
    if not folder.is_dir():
        return f" Nor is there a folder {folder}."
    names = [p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES]
    folded = {n.lower(): n for n in names}
    near = [folded[n] for n in get_close_matches(path.name.lower(), folded, n=3, cutoff=0.6)]
    if near:
        return f" Did you mean {' or '.join(near)}?"
    return f" The folder {folder} holds {len(names) or 'no'} images" + (
        f", e.g. {min(names)}." if names else "."
    )


def _open(data: bytes, path: Path) -> PIL.Image.Image:
    """The picture with its header read and its pixels still encoded, checked to be of a bearable
    size."""
    with _pillow_limit:  # Pillow would warn from 89 megapixels on and refuse from 179 on
        limit, PIL.Image.MAX_IMAGE_PIXELS = PIL.Image.MAX_IMAGE_PIXELS, None
        try:
            picture = PIL.Image.open(io.BytesIO(data))
        except UnidentifiedImageError:
            kind = (
                "a text file, not an image"
                if _is_text(data[:4096])
                else "not an image of a known kind"
            )
            raise ImageError(
                f"{path} is {kind}; JPEG, PNG, TIFF, BMP, WebP and PNM files can be read"
            ) from None
        finally:
            PIL.Image.MAX_IMAGE_PIXELS = limit
    w, h = picture.size
    if w * h > MAX_PIXELS:
        raise ImageError(_too_large(str(path), w, h))
    if w * h == 0:
        raise ImageError(f"{path} has no pixels: it is {w} x {h}")
    return picture


def _too_large(what: str, w: int, h: int) -> str:
    return f"{what} is {w:,} x {h:,} pixels; at most {MAX_PIXELS // 10**6} megapixels are read: make it smaller"


def _is_text(head: bytes) -> bool:
    try:
        return head.decode().isprintable() or not any(c < 9 for c in head)
    except UnicodeDecodeError:
        return False


def _decode(picture: PIL.Image.Image, data: bytes, path: Path) -> np.ndarray:
    """The stored pixels, (H, W) or (H, W, 3) uint8."""
    if picture.format in ("JPEG", "MPO") and picture.mode in ("RGB", "L"):
        # The same library and the same bits as Pillow, without a copy; None when the data end
        # early, and then Pillow says what is wrong.
        flag = cv2.IMREAD_GRAYSCALE if picture.mode == "L" else cv2.IMREAD_COLOR_RGB
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is not None:
            return pixels
    mode = picture.mode
    if mode in ("L", "RGB"):
        return np.asarray(picture)
    if mode.startswith("I"):  # 16 bit grey
        return _to_8bit(np.clip(np.asarray(picture), 0, 65535).astype(np.uint16), str(path))
    if mode == "F":
        return _to_8bit(np.asarray(picture), str(path))
    if mode in ("1", "LA", "La"):
        return np.asarray(picture.convert("L"))
    return np.asarray(picture.convert("RGB"))


# EXIF orientation -> what makes the stored rows and columns upright (EXIF 2.32, tag 0x0112)
_UPRIGHT = {
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a),
}


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    return _UPRIGHT[orientation](pixels) if orientation in _UPRIGHT else pixels


def _read_exif(picture: PIL.Image.Image) -> Exif | None:
    """What EXIF says; a damaged EXIF block says as much as can be read of it, and never stops the
    picture."""
    try:
        tags: dict[int, Any] = dict(picture.getexif())
        if not tags:
            return None
        tags |= picture.getexif().get_ifd(0x8769)
    except Exception:  # Pillow's EXIF parser raises almost anything on damaged blocks
        return None

    def number(tag: int) -> float | None:
        try:
            value = float(tags[tag])
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return None
        return value if math.isfinite(value) and value > 0 else None

    def text(tag: int) -> str | None:
        value = tags.get(tag)
        return value.split("\0")[0].strip() or None if isinstance(value, str) else None

    def pair(x: float | None, y: float | None) -> tuple[float, float] | None:
        return (x, y) if x and y else None

    orientation = int(number(0x0112) or 1)
    unit_mm = {3: 10.0, 4: 1.0, 5: 0.001}.get(
        int(number(0xA210) or 2), 25.4
    )  # 2, and whatever else: inches
    resolution = pair(number(0xA20E), number(0xA20F))
    size = pair(number(0xA002), number(0xA003))
    exif = Exif(
        make=text(0x010F),
        model=text(0x0110),
        orientation=orientation if 1 <= orientation <= 8 else 1,
        focal_mm=number(0x920A),
        focal_35mm=number(0xA405),
        focal_plane_resolution=resolution and (resolution[0] / unit_mm, resolution[1] / unit_mm),
        size_wh=size and (int(size[0]), int(size[1])),
    )
    return replace(exif, stored_wh=picture.size)
