"""Standard streams that neither raise nor end a command before its work is done."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any

__all__ = ["Output", "failure", "protect"]


class Output(io.FileIO):
    """A standard stream whose failed writes are remembered instead of raised.

    Attributes:
        failure: the first error, or None.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write `data`, and report it as written in any case."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return len(memoryview(data).cast("B"))


def protect() -> None:
    """Replace this process's output streams.

    Characters that their encoding lacks are written as escapes. A closed stream is opened on the
    null device for reading, so that no other file gets its number and writing to it fails.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDONLY)  # gets the lowest free number, which is this one
    sys.stdout = _protected(sys.stdout, 1)
    sys.stderr = _protected(sys.stderr, 2)


def failure() -> OSError | None:
    """What went wrong on standard output. A reader that has closed its end is not a failure."""
    raw = _raw(sys.stdout)
    if not isinstance(raw, Output):
        return None
    sys.stdout.flush()
    error = raw.failure
    return None if error is not None and error.errno == errno.EPIPE else error


def _raw(stream: Any) -> Any:
    buffer = getattr(stream, "buffer", None)
    return getattr(buffer, "raw", buffer)  # with PYTHONUNBUFFERED the buffer is the raw stream


def _protected(stream: Any, descriptor: int) -> Any:
    raw = _raw(stream)
    if stream is not None and not (type(raw) is io.FileIO and raw.fileno() == descriptor):
        return stream  # a console of Windows, or not the process's own
    if stream is not None:
        stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(Output(descriptor)),
        encoding=getattr(stream, "encoding", "utf-8"),
        errors="backslashreplace",
        line_buffering=getattr(stream, "line_buffering", False) or descriptor == 2,
    )
