"""Lines of COLMAP's text files; messages contain the line number."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import InputError


class TextFile:
    """The text of a file, and its name for messages."""

    def __init__(self, name: str, text: str):
        self.name = name
        self._lines = text.split("\n")

    @classmethod
    def read(cls, path: Path) -> TextFile:
        """Read a UTF-8 file, with or without a byte order mark.

        Raises:
            InputError: The file cannot be read or is not UTF-8.
        """
        try:
            return cls(str(path), path.read_text(encoding="utf-8-sig"))
        except FileNotFoundError:
            raise InputError(f"there is no file {path}") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not a text file in UTF-8") from None
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"{path} cannot be read: {why}") from error

    def numbered(self) -> Iterator[tuple[int, str]]:
        """Yield number, from 1, and text of every line that is not a comment."""
        for number, line in enumerate(self._lines, start=1):
            if not line.lstrip().startswith("#"):
                yield number, line.strip()

    def lines(self) -> Iterator[tuple[int, list[str]]]:
        """Yield number and words of every line that is neither empty nor a comment."""
        for number, line in self.numbered():
            if line:
                yield number, line.split()

    @contextmanager
    def at(self, number: int) -> Iterator[None]:
        """Add the file name and the line number to the message of an InputError."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.name}, line {number}: {error}") from None

    @staticmethod
    def whole(word: str) -> int:
        """Convert a word to an integer of at most 64 bits."""
        if not re.fullmatch(r"-?[0-9]{1,19}", word) or abs(int(word)) >= 2**63:
            raise InputError(f"'{word[:40]}' is not a whole number")
        return int(word)

    @staticmethod
    def number(word: str) -> float:
        try:
            return float(word)
        except ValueError:
            raise InputError(f"'{word[:40]}' is not a number") from None
