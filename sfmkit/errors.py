"""Exceptions of sfmkit. Every message states how to correct the problem."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class SfmError(Exception):
    """Base class of all errors that sfmkit raises."""


class InputError(SfmError, ValueError):
    """An argument, a file or an array is invalid."""


class ImageError(InputError):
    """An image file is missing, unreadable or of an unsupported kind."""


class CameraError(InputError):
    """Intrinsics are impossible or missing."""


class OperatorError(InputError):
    """An operator is unknown, not available, or fails."""

    @classmethod
    def unknown(cls, name: str, known: Iterable[str]) -> OperatorError:
        known = sorted(known)
        near = get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        return cls(
            f"unknown operator '{name}'.{hint} Known: {', '.join(known)}; or detector+descriptor."
        )


class OutputError(SfmError):
    """A result could not be written; no incomplete output is left."""


class DegenerateGeometryError(SfmError):
    """The correspondences do not determine the requested model.

    Attributes:
        counts: Numbers that were available and needed, such as ``{"matches": 4, "needed": 5}``.
    """

    def __init__(self, message: str, **counts: int):
        super().__init__(message)
        self.counts = counts
