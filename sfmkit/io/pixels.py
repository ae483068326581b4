"""Conversion of pixel values of any depth to 8 bit."""

from __future__ import annotations

import numpy as np

from .._utils.notices import warn
from ..errors import ImageError

DEPTHS = (8, 10, 12, 14, 16, 24, 31, 32)  # bits that sensors and files use
LEVELS = 64  # fewer grey levels are too few, such as those of 14-bit values in a 16-bit file
_INNER = (0.1, 99.9)  # percentiles of the darkest and the brightest value
_SAMPLES = 1_000_000  # number of values for the percentiles
_ROWS = 256  # rows that are stretched at a time


class ImageWarning(UserWarning):
    """Warning: an image was adapted or may be damaged, and results depend on it."""


def integers_to_8bit(pixels: np.ndarray, what: str) -> np.ndarray:
    """Convert integers of more than 8 bit to uint8.

    16-bit values keep their high byte. With this rule, values that use a small part of the range
    would become a few grey levels. Therefore, 12-bit values in a 16-bit file are interpreted as
    12 bit, and values in a narrow band (thermal images) are stretched from the darkest to the
    brightest value, both with an :class:`ImageWarning`. The range of 32-bit integers is the
    smallest common depth that contains the largest value.
    """
    low, high = int(pixels.min()), int(pixels.max())
    full = 16 if pixels.dtype.itemsize == 2 else _depth(high)
    if 0 <= low == high:
        return _shift(pixels, full)
    dark, bright = _inner_range(pixels)
    if low >= 0 and (bright - dark) * 256 / 2**full > LEVELS:
        return _shift(pixels, full)
    used = _depth(high)
    if low >= 0 and (bright - dark) * 256 / 2**used > LEVELS:
        if used < full:
            _warn(what, f"uses {used} of {full} bits; its values were taken as {used} bit")
        return _shift(pixels, used)
    if bright <= dark:
        dark, bright = float(low), float(high)
    _warn(what, f"uses the values from {dark:g} to {bright:g} only; they were stretched")
    return _stretch(pixels, dark, bright)


def floats_to_8bit(pixels: np.ndarray, what: str, *, stretch: bool = False) -> np.ndarray:
    """Convert floats in [0, 1] to uint8.

    Args:
        pixels: Array of floats.
        what: Name of the image in messages.
        stretch: Whether to stretch values outside [0, 1] from the darkest to the brightest value,
            with an :class:`ImageWarning`, instead of raising an error.

    Raises:
        ImageError: A value is NaN or infinite, or is outside [0, 1] without `stretch`.
    """
    if not np.isfinite(pixels).all():
        raise ImageError(f"{what} holds NaN or infinite values")
    low, high = float(pixels.min()), float(pixels.max())
    if low >= 0 and high <= 1:
        return np.rint(pixels * 255).astype(np.uint8)
    if not stretch:
        raise ImageError(
            f"{what} of floats must lie in [0, 1], not in [{low:g}, {high:g}]; "
            "scale it or use uint8"
        )
    dark, bright = _inner_range(pixels)
    if bright <= dark:
        dark, bright = low, high
    _warn(what, f"uses the values from {dark:g} to {bright:g}; they were stretched")
    return _stretch(pixels, dark, bright)


def _inner_range(pixels: np.ndarray) -> tuple[float, float]:
    some = pixels.reshape(-1)[:: max(1, pixels.size // _SAMPLES)]
    dark, bright = np.percentile(some, _INNER)
    return float(dark), float(bright)


def _depth(largest: int) -> int:
    """Return the smallest common number of bits for `largest`."""
    return next((bits for bits in DEPTHS if largest < 2**bits), 64)


def _shift(pixels: np.ndarray, bits: int) -> np.ndarray:
    return (pixels >> (bits - 8)).astype(np.uint8)


def _stretch(pixels: np.ndarray, dark: float, bright: float) -> np.ndarray:
    scale = 255 / (bright - dark) if bright > dark else 0.0
    grey = np.empty(pixels.shape, np.uint8)
    for start in range(0, len(pixels), _ROWS):  # in blocks, to limit the memory for floats
        rows = pixels[start : start + _ROWS].astype(np.float64)
        grey[start : start + _ROWS] = np.rint(((rows - dark) * scale).clip(0, 255))
    return grey


def _warn(what: str, text: str) -> None:
    warn(
        f"{what} {text}. Compare both photographs, and save them as 8 bit where that is not right",
        ImageWarning,
        stacklevel=2,
    )
