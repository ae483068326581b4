"""Detection of damage in JPEG files that decoders do not report.

A JPEG decoder converts any bits to pixels, so a file with a lost disk sector can still be decoded.
The checks look for data that an intact file cannot contain (ITU-T T.81, annex B).
"""

from __future__ import annotations

import re

import numpy as np

_ZEROS = bytes(512)  # one disk sector
_FLAT_ROWS = 16  # of pixels: one row of blocks with subsampled colour
_BASELINE = {0xC0, 0xC1}  # frames coded in one pass; in other frames long runs of zeros are valid
_SOS, _DHT, _EOI, _DNL = 0xDA, 0xC4, 0xD9, 0xDC
_TABLES = {*range(0xC0, 0xD0), *range(0xDB, 0xF0), 0xFE}  # markers that may follow a scan
_MARKER = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]", re.DOTALL)


def jpeg_damage(data: bytes, pixels: np.ndarray) -> str | None:
    """Describe the damage of a JPEG file that was decoded; return None for an intact file.

    Args:
        data: Bytes of the file.
        pixels: (H, W) or (H, W, 3) uint8 decoded pixels, not turned upright.

    Returns:
        ``a block of zeros lies in the picture data``, ``picture data hold an invalid marker`` or
        ``the lower part has one colour``.
    """
    return _scan_damage(data) or _fill(pixels)


def _scan_damage(data: bytes) -> str | None:
    """Check the entropy-coded data between the segments."""
    position, baseline, zeros_mean_detail = 2, False, False
    while position + 4 <= len(data) and data[position] == 0xFF:
        marker = data[position + 1]
        if marker == 0xFF:  # fill byte
            position += 1
            continue
        if marker == _EOI:
            return None
        length = int.from_bytes(data[position + 2 : position + 4], "big")
        body, position = data[position + 4 : position + 2 + length], position + 2 + length
        baseline |= marker in _BASELINE
        if marker == _DHT:
            zeros_mean_detail |= _zero_code_is_a_coefficient(body)
        if marker != _SOS:
            continue
        found = _MARKER.search(data, position)
        end = found.start() if found else len(data)
        if baseline and zeros_mean_detail and data.find(_ZEROS, position, end) >= 0:
            return "a block of zeros lies in the picture data"
        if found and found[0][-1] not in _TABLES | {_EOI, _SOS, _DNL}:
            return "the picture data hold an invalid marker"
        position = end
    return None


def _zero_code_is_a_coefficient(body: bytes) -> bool:
    """Return whether an AC table assigns its first code, all zeros, to a coefficient.

    Then a run of zeros encodes full detail in every block, which does not occur. In tables for a
    uniform picture this code is "end of block", and a run of zeros is valid.
    """
    while len(body) >= 18:
        count = sum(body[1:17])
        if body[0] >> 4 == 1 and body[17] & 0x0F:
            return True
        body = body[17 + count :]
    return False


def _fill(pixels: np.ndarray) -> str | None:
    """Detect a lower part of one colour, with which decoders fill missing data.

    Black and white are ignored because borders and backgrounds have these colours.
    """
    if len(pixels) < 2 * _FLAT_ROWS:
        return None
    flat = pixels[-_FLAT_ROWS:].reshape(-1, *pixels.shape[2:])
    colour = flat[0]
    if (flat != colour).any() or colour.max() < 8 or colour.min() > 247:
        return None
    whole = pixels[: len(pixels) // 2].reshape(-1, *pixels.shape[2:])
    return "the lower part has one colour" if (whole != colour).any() else None
