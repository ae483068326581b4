"""Standard streams whose errors do not interrupt the work of a command."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any

__all__ = ["Output", "failure", "protect"]


class Output(io.FileIO):
    """A standard stream that stores write errors instead of raising them.

    Attributes:
        failure: The first error, or None.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write `data`; return its length even if writing fails."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return len(memoryview(data).cast("B"))


def protect() -> None:
    """Replace the output streams of this process.

    Characters outside the encoding are written as escapes. A closed stream is opened on the null
    device for reading, so that no other file gets its descriptor and writing to it fails.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(
                os.devnull, os.O_RDONLY
            )  # the lowest free descriptor, which is that of the closed stream
    sys.stdout = _protected(sys.stdout, 1)
    sys.stderr = _protected(sys.stderr, 2)


def failure() -> OSError | None:
    """Return the error of standard output, or None. A closed pipe is not an error."""
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
        return stream  # a Windows console, or a replaced stream
    if stream is not None:
        stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(Output(descriptor)),
        encoding=getattr(stream, "encoding", "utf-8"),
        errors="backslashreplace",
        line_buffering=getattr(stream, "line_buffering", False) or descriptor == 2,
    )
