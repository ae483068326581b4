"""The protocol for progress reports of long computations."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """A callback for progress reports.

    Long-running functions have a parameter ``progress`` and call it as ``progress(stage, detail)``
    or, if the completed share of the work is known, as ``progress(stage, detail, fraction=0.25)``.
    The return value is ignored.
    """

    def __call__(self, stage: str, detail: str = "", *, fraction: float | None = None) -> None:
        """Report progress.

        Args:
            stage: Part of the work in one or two words, such as ``detect``.
            detail: Current task within the stage, such as ``surf, image 1``.
            fraction: Completed share of the whole work, 0 to 1; None if unknown.
        """


def silent(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
    """Report nothing; the default of parameters of type :class:`Progress`."""
