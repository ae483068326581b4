"""Headers of PLY files, and ASCII bodies that plyfile cannot read.

plyfile accepts only files that follow the specification exactly. Like other programs, this module
also accepts headers with a byte order mark, blank lines, trailing spaces or text that is not ASCII,
and bodies whose words are not arranged in lines.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError

_HEADER_BYTES = 1_000_000  # largest header
_BODY_BYTES = 200_000_000  # largest ASCII body that is read word by word
_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass(frozen=True)
class Property:
    """A property of an element: name, NumPy type, and type of the length of a list.

    The last one is None for a scalar.
    """

    name: str
    kind: str
    length_kind: str | None = None

    def least_bytes(self, text: bool) -> int:
        """Return the smallest number of bytes that the property takes in the body."""
        return 2 if text else np.dtype(self.length_kind or self.kind).itemsize


@dataclass(frozen=True)
class Element:
    """An element: its name, count and properties."""

    name: str
    count: int
    properties: tuple[Property, ...]


@dataclass(frozen=True)
class Header:
    """A PLY header.

    Attributes:
        text: Whether the body is ASCII.
        elements: Elements in the order of the body.
        comments: Comments without the word "comment".
        size: Number of bytes before the body.
        canonical: The same header in a form that plyfile accepts.
        as_is: Whether plyfile accepts the header of the file.
    """

    text: bool
    elements: tuple[Element, ...]
    comments: list[str]
    size: int
    canonical: bytes
    as_is: bool


def read_header(path: Path) -> Header:
    """Read and check the header of a file.

    Raises:
        InputError: The header is invalid, or declares more data than the file contains.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    mark = len(_MARK) if head.startswith(_MARK) else 0
    head = head[mark:]
    if head[:3].lower() != b"ply":
        raise InputError("it does not begin with 'ply'")
    end = re.search(rb"[\r\n][ \t]*end_header[ \t]*(\r\n|\r|\n)", head)
    if not end:
        raise InputError("the header has no end_header")
    newline = re.search(rb"\r\n|\r|\n", head)
    size = end.end()
    if end[1] == b"\r\n" and newline and newline[0] == b"\r":
        size -= 1  # the line feed is the first byte of the body
    raw = head[: end.start()].decode("utf-8", "replace")
    lines = [_canonical(line) for line in re.split(r"\r\n|\r|\n", raw)]
    lines = ["ply", *(line for line in lines[1:] if line), "end_header"]
    text, elements = _parse(lines)
    canonical = ("\n".join(lines) + "\n").encode("ascii", "backslashreplace")
    body = path.stat().st_size - mark - size
    for element in elements:
        least = sum(p.least_bytes(text) for p in element.properties)
        if element.count * least > body + 1:
            raise InputError(
                f"early end-of-file: {element.count:,} of element '{element.name}' take at least "
                f"{element.count * least:,} bytes and {body:,} follow the header"
            )
    strict = head[:size].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]
    return Header(
        text, elements, comments, mark + size, canonical, not mark and strict == canonical
    )


def _canonical(line: str) -> str:
    """Return the line with single spaces; comments are not changed."""
    words = line.split()
    return line if words and words[0] in ("comment", "obj_info") else " ".join(words)


def _parse(lines: list[str]) -> tuple[bool, tuple[Element, ...]]:
    """Parse the lines of a header: whether the body is text, and the elements."""
    text: bool | None = None
    elements: list[Element] = []
    for number, line in enumerate(lines[1:-1], start=2):
        words = line.split()
        match words:
            case ["comment" | "obj_info", *_]:
                pass
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian", _]:
                text = words[1] == "ascii"
            case ["element", name, count] if re.fullmatch(r"[0-9]{1,18}", count):
                elements.append(Element(name, int(count), ()))
            case ["property", "list", length, kind, name] if (
                elements and length in _TYPES and kind in _TYPES
            ):
                _add(elements, Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                _add(elements, Property(name, _TYPES[kind]))
            case _:
                raise InputError(f"header line {number} is not PLY: '{line[:60]}'")
    if text is None:
        raise InputError("the header has no format")
    return text, tuple(elements)


def _add(elements: list[Element], item: Property) -> None:
    last = elements[-1]
    elements[-1] = Element(last.name, last.count, (*last.properties, item))


def read_words(path: Path, header: Header, name: str) -> np.ndarray | None:
    """Read the scalar properties of one element of an ASCII file, word by word.

    Returns:
        A structured array; None if the file is binary, too large, or contains too few words or
        words that are not numbers.
    """
    data = path.read_bytes()[header.size :] if header.text else b""
    if not header.text or len(data) > _BODY_BYTES:
        return None
    words = data.split()
    position = 0
    try:
        for element in header.elements:
            rows, position = _rows(words, position, element)
            if element.name == name:
                return rows
    except (IndexError, ValueError, OverflowError):
        pass
    return None


def _rows(words: list[bytes], position: int, element: Element) -> tuple[np.ndarray, int]:
    """Read the scalar properties of an element from `position`; also return their end."""
    scalars = [p for p in element.properties if p.length_kind is None]
    rows = np.zeros(element.count, [(p.name, p.kind) for p in scalars])
    if len(scalars) == len(element.properties):
        width = len(scalars)
        table = words[position : position + width * element.count]
        if len(table) < width * element.count:
            raise IndexError
        for k, p in enumerate(scalars):
            rows[p.name] = np.array([_number(word) for word in table[k::width]])
        return rows, position + len(table)
    for row in range(element.count):
        for p in element.properties:
            if p.length_kind:
                length = int(words[position])
                if length < 0:
                    raise ValueError
                position += 1 + length
            else:
                rows[p.name][row] = _number(words[position])
                position += 1
    return rows, position


def _number(word: bytes) -> float:
    """Convert a word to a number; NaN also for the spellings of NaN and infinity of C runtimes."""
    try:
        return float(word)
    except ValueError:
        if re.fullmatch(rb"[-+]?(nan|inf|1\.#)[\w()#]*", word.lower()):
            return float("nan")
        raise
