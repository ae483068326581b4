"""Warnings that a caller can collect per thread, without changing Python's filters."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_collecting: ContextVar[list[str] | None] = ContextVar("sfmkit_notices", default=None)


def warn(message: str, category: type[Warning] = UserWarning, stacklevel: int = 1) -> None:
    """Add a message to the list of the innermost :func:`collected`, or issue a warning.

    ``warnings.catch_warnings`` changes the filters of the whole process, so it suppresses the
    warnings of other libraries and of other threads. This function does not.

    Args:
        message: Text of the warning.
        category, stacklevel: As for :func:`warnings.warn`.
    """
    messages = _collecting.get()
    if messages is None:
        warnings.warn(message, category, stacklevel + 1)
    elif message not in messages:
        messages.append(message)


@contextmanager
def collected() -> Iterator[list[str]]:
    """Collect the messages of :func:`warn` in this thread, each once, instead of warning."""
    messages: list[str] = []
    token = _collecting.set(messages)
    try:
        yield messages
    finally:
        _collecting.reset(token)
