"""Pair lists in JSON or CSV, with image paths, cameras and known geometry."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.intrinsics import parse_intrinsics
from ..types import Camera
from .pair import KINDS, Pair, image_size

TEXTS = ("image1", "image2", "name", "sequence", "kind", "camera1", "camera2")
ARRAYS = ("K1", "K2", "distortion1", "distortion2", "R", "t", "H", "check_points")
FIELDS = (*TEXTS, *ARRAYS)

Row = Mapping[str, Any]


def pair_list(
    root: str | os.PathLike,
    sequences: Iterable[str] | None = None,
    *,
    images: str | os.PathLike | None = None,
) -> Iterator[Pair]:
    """Yield the pairs of a ``.json`` or ``.csv`` list.

    JSON: a list of objects, or an object with such a list under ``pairs``. CSV: a header and one
    line per pair; the numbers of a cell are separated by spaces. The fields are :data:`FIELDS`;
    only ``image1`` and ``image2`` are required. ``check_points`` are rows of x1, y1, x2, y2, or the
    path of a text file with such rows. ``camera1`` and ``camera2`` have the form of
    ``--intrinsics``: a camera file or numbers. K or camera of image 2 defaults to that of image 1.
    ``kind`` (``homography`` or ``two-view``) defaults to ``homography`` if H is given.

    Args:
        root: Path of the list.
        sequences: Names in the field ``sequence``; None for all.
        images: Folder of relative image paths; None for the folder of the list.

    Raises:
        InputError: The list cannot be read, or an entry is malformed; the message names the entry
            and the field.
    """
    file = Path(root)
    rows = read_pair_list(file)
    folder = file.parent if images is None else Path(images)
    wanted = None if sequences is None else set(sequences)
    known = {_text(row, "sequence", where, file.stem) for where, row in rows}
    if wanted is not None and not wanted <= known:
        missing = ", ".join(sorted(wanted - known))
        raise InputError(
            f"{file} has no sequence {missing}; it has {', '.join(sorted(map(str, known)))}"
        )
    for number, (where, row) in enumerate(rows, start=1):
        if wanted is None or _text(row, "sequence", where, file.stem) in wanted:
            yield _pair(row, where, file, folder, number)


def read_pair_list(file: Path) -> list[tuple[str, Row]]:
    """Read the entries of a list, with their positions for messages; fields are not checked.

    Raises:
        InputError: The file cannot be read, is not a list of pairs, is empty, or has unknown
            fields.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
        rows = _csv_rows(text, file) if file.suffix.lower() == ".csv" else _json_rows(text, file)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        raise InputError(f"{file} cannot be read: {error}") from None
    if not rows:
        raise InputError(f"{file} lists no pairs")
    for where, row in rows:
        unknown = [str(name) for name in row if name not in FIELDS]
        if unknown:
            raise InputError(
                f"{where}: unknown field {', '.join(unknown)}; the fields are {', '.join(FIELDS)}"
            )
    return rows


def find_listed_image(folder: Path, name: str, where: str) -> Path:
    """Find an image of a list by an absolute path or a path relative to `folder`.

    Raises:
        InputError: There is no such file.
    """
    path = folder / name
    try:
        found = path.is_file()
    except (OSError, ValueError):  # a name that is too long or holds a NUL character
        found = False
    if not found:
        raise InputError(f"{where}: there is no image {str(path)!r}")
    return path


def reject_sequences(file: Path, sequences: Iterable[str] | None) -> None:
    """Raise InputError if sequences are chosen from a list without sequences."""
    if sequences is not None:
        raise InputError(f"{file} has no sequences to choose from: {', '.join(sequences)}")


def _json_rows(text: str, file: Path) -> list[tuple[str, Row]]:
    data = json.loads(text)
    rows = data.get("pairs") if isinstance(data, dict) else data
    if not isinstance(rows, list):
        raise InputError(f"{file} must hold a list of pairs, or an object with a list 'pairs'")
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict):
            raise InputError(
                f"{file.name}, pair {number}: must be an object, not a {type(row).__name__}"
            )
    return [(f"{file.name}, pair {number}", row) for number, row in enumerate(rows, start=1)]


def _csv_rows(text: str, file: Path) -> list[tuple[str, Row]]:
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    rows: list[tuple[str, Row]] = []
    for row in reader:
        where = f"{file.name}, line {reader.line_num}"
        if None in row:
            raise InputError(f"{where}: more cells than the header has columns")
        rows.append((where, {k.strip(): v for k, v in row.items() if v is not None and v.strip()}))
    return rows


def _pair(row: Row, where: str, file: Path, folder: Path, number: int) -> Pair:
    kind = _text(row, "kind", where)
    if kind is not None and kind not in KINDS:
        raise InputError(f"{where}: kind: must be {' or '.join(KINDS)}, not {kind!r}")
    image1, image2 = (
        find_listed_image(folder, _required(row, field, where), f"{where}: {field}")
        for field in ("image1", "image2")
    )
    camera1 = _camera(row, "1", image1, where, file.parent)
    camera2 = _camera(row, "2", image2, where, file.parent)
    if camera2 is None and camera1 is not None:
        camera2 = _camera(row, "1", image2, where, file.parent)
    try:
        return Pair(
            file.stem,
            _text(row, "sequence", where, file.stem) or file.stem,
            _text(row, "name", where) or f"{number}",
            image1,
            image2,
            camera1,
            camera2,
            H=_array(row, "H", (3, 3), where),
            R=_array(row, "R", (3, 3), where),
            t=_array(row, "t", (3,), where),
            check_points=_check_points(row, where, file.parent),
            kind=kind,
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(where) else f"{where}: {text}") from None


def _camera(row: Row, which: str, image: Path, where: str, folder: Path) -> Camera | None:
    """Read the camera of an image from K and distortion, a camera file, or numbers."""
    given, K = row.get(f"camera{which}"), _array(row, f"K{which}", (3, 3), where)
    distortion = _array(row, f"distortion{which}", (-1,), where)
    if K is None and distortion is not None:
        raise InputError(f"{where}: distortion{which}: needs K{which}")
    try:
        if K is not None:
            if given is not None:
                raise InputError(f"give K{which} or camera{which}, not both")
            return Camera(K, image_size(image), np.zeros(5) if distortion is None else distortion)
        if given is None:
            return None
        text = _required(row, f"camera{which}", where)
        beside = folder / text
        return parse_intrinsics(beside if beside.is_file() else text, image_size(image))
    except (InputError, OSError, ValueError) as error:
        field = f"K{which}" if K is not None else f"camera{which}"
        raise InputError(f"{where}: {field}: {error}") from None


def _check_points(row: Row, where: str, folder: Path) -> np.ndarray | None:
    value = row.get("check_points")
    if isinstance(value, str) and value.strip():
        try:
            file = folder / value.strip()
            if file.is_file():
                value = file.read_text(encoding="utf-8-sig").replace(",", " ")
        except (OSError, ValueError) as error:
            raise InputError(f"{where}: check_points: {error}") from None
        row = {"check_points": value}
    return _array(row, "check_points", (-1, 4), where)


def _required(row: Row, field: str, where: str) -> str:
    text = _text(row, field, where)
    if text is None:
        raise InputError(f"{where}: {field}: missing")
    return text


def _text(row: Row, field: str, where: str, default: str | None = None) -> str | None:
    value = row.get(field)
    if value is None or value == "":
        return default
    if not isinstance(value, str):
        raise InputError(f"{where}: {field}: must be text, not {_short(value)}")
    return value


def _array(row: Row, field: str, shape: tuple[int, ...], where: str) -> np.ndarray | None:
    """Read finite numbers of a shape (-1 for any length); None if the field is absent."""
    value = row.get(field)
    if value is None or value == "":
        return None
    numbers = value.replace(";", " ").split() if isinstance(value, str) else value
    try:
        array = np.array(numbers, dtype=np.float64)
        size = array.size
        array = array.reshape(shape)
    except (ValueError, TypeError, OverflowError, RecursionError):
        expected = " x ".join("N" if n < 0 else str(n) for n in shape)
        raise InputError(
            f"{where}: {field}: must hold {expected} numbers, not {_short(value)}"
        ) from None
    if not size or not np.isfinite(array).all():
        raise InputError(f"{where}: {field}: must hold finite numbers, not {_short(value)}")
    return array


def _short(value: Any) -> str:
    try:
        text = repr(value)
    except (RecursionError, ValueError):  # nested too deeply, or an integer of too many digits
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:57]}..."
