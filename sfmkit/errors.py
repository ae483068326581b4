"""What can go wrong, as types. Every message says what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class SfmError(Exception):
    """Base of every error that sfmkit raises on purpose."""


class InputError(SfmError, ValueError):
    """An argument, a file or an array is not what the call needs."""


class ImageError(InputError):
    """An image file is missing, unreadable or of an unusable kind."""


class CameraError(InputError):
    """Intrinsics that no camera can have, or none to be found."""


class OperatorError(InputError):
    """An operator's name is unknown, or the operator is not available here."""

    @classmethod
    def unknown(cls, name: str, known: Iterable[str]) -> OperatorError:
        known = sorted(known)
        near = get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f" Did you mean '{near[0]}'?" if near else ""
        return cls(
            f"unknown operator '{name}'.{hint} Known: {', '.join(known)}; or detector+descriptor."
        )


class OutputError(SfmError):
    """A result could not be written; nothing half-written is left behind."""


class DegenerateGeometryError(SfmError):
    """The correspondences do not determine the model asked for.

    Attributes:
        counts: What was there and what would have been needed, e.g.
            ``{"matches": 4, "needed": 5}``.
    """

    def __init__(self, message: str, **counts: int):
        super().__init__(message)
        self.counts = counts
