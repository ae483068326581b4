"""The one way in which long work reports how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """A function that is called while work goes on.

    Long-running functions take one as their argument ``progress`` and call it as
    ``progress(stage, detail)`` or, where the share of the work that is done is known, as
    ``progress(stage, detail, fraction=0.25)``. The return value is ignored.
    """

    def __call__(self, stage: str, detail: str = "", *, fraction: float | None = None) -> None:
        """Report progress.

        Args:
            stage: The part of the work, one or two words: ``detect``.
            detail: What is being done within it: ``surf, image 1``.
            fraction: Share of the whole work that is done, 0 to 1; None where it is unknown.
        """


def silent(stage: str, detail: str = "", *, fraction: float | None = None) -> None:
    """Report nothing: the default where a function takes a :class:`Progress`."""
