"""Read photographs: decoded, upright, 8 bit, with the metadata of the camera."""

from __future__ import annotations

import io
import os
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from PIL import UnidentifiedImageError

from .._utils.notices import warn
from ..errors import ImageError
from .exif import Exif, read_exif
from .jpeg import jpeg_damage
from .pixels import ImageWarning, floats_to_8bit, integers_to_8bit

MAX_PIXELS = 500_000_000  # decoding takes 8 bytes per pixel, the image 4: 4 GB and 2 GB
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm", ".gif")
# Permitted decoders (JPEG covers MPO). Some other decoders of Pillow start programs.
FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "PPM", "GIF")
READABLE = "JPEG, PNG, TIFF, BMP, WebP, PNM and GIF files can be read"
TURNED_BY_THE_DECODER = ("TIFF",)  # Pillow and OpenCV turn only TIFF upright
_FOREIGN = (  # (offset, signature, description)
    (0, b"%!PS", "a PostScript file"),
    (0, b"\xc5\xd0\xd3\xc6", "a PostScript file"),
    (0, b"%PDF", "a PDF file"),
    (4, b"ftypheic", "a HEIC picture"),
    (4, b"ftypmif1", "a HEIC picture"),
    (4, b"ftypavif", "an AVIF picture"),
    (4, b"jP  ", "a JPEG 2000 picture"),
    (0, b"8BPS", "a Photoshop file"),
)

_pillow_limit = threading.RLock()  # the pixel limit of Pillow is a global variable


@dataclass(frozen=True, eq=False)
class Image:
    """An upright photograph.

    Attributes:
        rgb: (H, W, 3) uint8.
        grey: (H, W) uint8, ``0.299 R + 0.587 G + 0.114 B`` (ITU-R BT.601), rounded as by
            ``cv2.cvtColor``.
        path: Path of the file; None for an array.
        exif: Metadata of the camera; None for an array or a file without EXIF.
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
        """The name of the file, or ``array``."""
        return self.path.name if self.path else "array"

    def __repr__(self) -> str:
        return f"Image({self.name}, {self.size_wh[0]} x {self.size_wh[1]})"


def read_image(source: str | os.PathLike | np.ndarray | Image) -> Image:
    """Read a photograph from a file or an array.

    The formats are JPEG, PNG, TIFF, BMP, WebP, PNM and GIF; no other decoder is started. Files may
    be 8 or 16 bit, RGB, grey, palette or CMYK, 32-bit integer or float grey, with or without alpha.
    Of several frames the first one is read. 16-bit values keep their high byte (``v >> 8``) unless
    they use only a small part of the range; then they are scaled by this part, with an
    :class:`~sfmkit.io.pixels.ImageWarning`. A damaged JPEG file that can be decoded also causes a
    warning. Alpha is dropped and the stored colours are used, so that no edge appears where the
    image becomes transparent. The EXIF orientation is applied once; sizes are upright sizes.

    Args:
        source: A path; or an array (H, W), (H, W, 1), (H, W, 3) RGB or (H, W, 4) RGBA of uint8,
            uint16 or floats in [0, 1]; or an :class:`Image`, which is returned unchanged.

    Raises:
        ImageError: The file is missing, a folder, empty, damaged, truncated or of an unknown
            format, it has more than 500 megapixels (checked before decoding, which takes 8 bytes
            per pixel), or the array has another shape or dtype.
    """
    if isinstance(source, Image):
        return source
    if isinstance(source, (str, os.PathLike)):
        return _read_file(Path(source))
    if isinstance(source, np.ndarray):
        return _image(_array_to_8bit(source, "the array"))
    raise ImageError(f"an image is a path or a NumPy array, not {type(source).__name__}")


def _array_to_8bit(pixels: np.ndarray, what: str) -> np.ndarray:
    """Check shape and dtype of `pixels` and convert them to uint8."""
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] not in (1, 3, 4)):
        raise ImageError(
            f"{what} must have shape (H, W), (H, W, 3) or (H, W, 4), not {pixels.shape}"
        )
    if 0 in pixels.shape:
        raise ImageError(f"{what} has no pixels: its shape is {pixels.shape}")
    if pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        raise ImageError(_too_large(what, pixels.shape[1], pixels.shape[0]))
    if pixels.ndim == 3:
        pixels = pixels[..., :3]  # without alpha
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype == np.uint16:
        return integers_to_8bit(pixels, what)
    if pixels.dtype.kind == "f":
        return floats_to_8bit(pixels, what)
    raise ImageError(f"{what} must be uint8, uint16 or floats in [0, 1], not {pixels.dtype}")


def _image(pixels: np.ndarray, path: Path | None = None, exif: Exif | None = None) -> Image:
    """Make the image of (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) uint8 pixels."""
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        grey = np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
        return Image(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), grey, path, exif)
    rgb = np.ascontiguousarray(pixels[..., :3])
    return Image(rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), path, exif)


def _read_file(path: Path) -> Image:
    return decode_image(_read_bytes(path), path)


def decode_image(data: bytes, path: Path) -> Image:
    """Decode the bytes of a file as :func:`read_image` does; `path` is only used in messages.

    Raises:
        ImageError: As for :func:`read_image`.
    """
    try:
        with _open(data, path) as picture:
            exif = read_exif(picture)
            pixels = _decode(picture, data, path)
    except ImageError:
        raise
    except Exception as error:  # Pillow's decoders raise almost anything on damaged files
        raise _undecodable(path, error) from error
    if exif is not None and picture.format not in TURNED_BY_THE_DECODER:
        pixels = _upright(pixels, exif.orientation)
    return _image(pixels, path, exif)


def _undecodable(path: Path, error: Exception) -> ImageError:
    if "truncated" in str(error).lower() or isinstance(error, EOFError):
        return ImageError(f"{path} is truncated: it ends before the picture does; fetch it again")
    return ImageError(
        f"{path} cannot be decoded ({error}): it is damaged or of an unsupported kind"
    )


def _read_bytes(path: Path) -> bytes:
    """Read the bytes of a file; an ImageError states why they cannot be read."""
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
    """Suggest existing files for a missing `path`."""
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
    """Open a picture without decoding its pixels, and check its size."""
    with no_pillow_limit():
        try:
            picture = PIL.Image.open(io.BytesIO(data), formats=FORMATS)
        except UnidentifiedImageError:
            raise ImageError(f"{path} is {_kind(data)}; {READABLE}") from None
    w, h = picture.size
    if w * h > MAX_PIXELS:
        raise ImageError(_too_large(str(path), w, h))
    if w * h == 0:
        raise ImageError(f"{path} has no pixels: it is {w} x {h}")
    return picture


@contextmanager
def no_pillow_limit():
    """Switch off Pillow's limit (warning above 89 megapixels, error above 179) for one thread."""
    with _pillow_limit:
        limit, PIL.Image.MAX_IMAGE_PIXELS = PIL.Image.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            PIL.Image.MAX_IMAGE_PIXELS = limit


def _kind(data: bytes) -> str:
    """Describe a file that no decoder recognised."""
    for offset, magic, kind in _FOREIGN:
        if data.startswith(magic, offset):
            return f"{kind}, not a photograph of a known kind"
    return "a text file, not an image" if _is_text(data[:4096]) else "not an image of a known kind"


def _too_large(what: str, w: int, h: int) -> str:
    return (
        f"{what} is {w:,} x {h:,} pixels; at most {MAX_PIXELS // 10**6} megapixels are read: "
        "make it smaller"
    )


def _is_text(head: bytes) -> bool:
    try:
        return head.decode().isprintable() or not any(c < 9 for c in head)
    except UnicodeDecodeError:
        return False


def _decode(picture: PIL.Image.Image, data: bytes, path: Path) -> np.ndarray:
    """The pixels (H, W) or (H, W, 3) uint8 as the decoder returns them."""
    if picture.format in ("JPEG", "MPO") and picture.mode in ("RGB", "L"):
        pixels = _decode_jpeg(picture, data, path)
        if pixels is not None:
            return pixels
    if picture.width * picture.height > (PIL.Image.MAX_IMAGE_PIXELS or MAX_PIXELS):
        with no_pillow_limit():  # TIFF checks the size again while it decodes
            picture.load()
    else:
        picture.load()
    mode = picture.mode
    if mode in ("L", "RGB", "RGBA") and _is_deep(picture, data):
        deep = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if deep is not None and deep.dtype == np.uint16 and deep.ndim == 3:
            return integers_to_8bit(deep[..., 2::-1], str(path))
    if mode in ("L", "RGB"):
        return np.asarray(picture)
    if mode.startswith("I"):
        values = np.asarray(picture)
        if mode != "I" or picture.format == "PPM" or _is_deep(picture, data):
            values = values.clip(0, 65535).astype(np.uint16)
        return integers_to_8bit(values, str(path))
    if mode == "F":
        return floats_to_8bit(np.asarray(picture), str(path), stretch=True)
    if mode in ("1", "LA", "La"):
        return np.asarray(picture.convert("L"))
    return np.asarray(picture.convert("RGB"))


def _decode_jpeg(picture: PIL.Image.Image, data: bytes, path: Path) -> np.ndarray | None:
    """Decode the stored pixels with OpenCV; return None if the data end early.

    OpenCV uses the same library as Pillow and returns the same values without a copy. For truncated
    data, Pillow reports the error.
    """
    flag = cv2.IMREAD_GRAYSCALE if picture.mode == "L" else cv2.IMREAD_COLOR_RGB
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION)
    damage = None if pixels is None else jpeg_damage(data, pixels)
    if damage:
        warn(
            f"{path} is damaged: {damage}. Parts of the picture are wrong; use an undamaged copy",
            ImageWarning,
            stacklevel=2,
        )
    return pixels


def _is_deep(picture: PIL.Image.Image, data: bytes) -> bool:
    """Return whether the file has 16 bits per channel.

    Source: PNG specification, IHDR; TIFF 6.0, BitsPerSample.
    """
    if picture.format == "PNG":
        return data[24:25] == b"\x10"
    bits = getattr(picture, "tag_v2", {}).get(258, ())
    return picture.format == "TIFF" and set(bits if isinstance(bits, tuple) else (bits,)) == {16}


# EXIF orientation -> transformation to upright rows and columns (EXIF 2.32, tag 0x0112)
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
