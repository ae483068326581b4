"""SIGTERM and SIGHUP as exceptions, so that a command cleans up as after Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["Terminated", "cause_of", "describe", "raised_as_exceptions", "status_of"]


class Terminated(KeyboardInterrupt):
    """The process received a termination signal.

    The class is derived from KeyboardInterrupt, so that code that cleans up after Ctrl-C also
    handles it.

    Attributes:
        signal: The signal.
    """

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(number.name)
        self.signal = number


def status_of(interrupt: KeyboardInterrupt) -> int:
    """Return the exit status 128 + n for the signal n."""
    return 128 + (interrupt.signal if isinstance(interrupt, Terminated) else signal.SIGINT)


def cause_of(error: BaseException) -> KeyboardInterrupt | None:
    """Return the interrupt that caused an exception.

    An interrupted import of an extension module raises ImportError.
    """
    seen: BaseException | None = error
    while seen is not None and not isinstance(seen, KeyboardInterrupt):
        seen = seen.__cause__ or seen.__context__
    return seen


def describe(interrupt: KeyboardInterrupt) -> str:
    """Describe the interrupt for a message."""
    return f"ended by {interrupt}" if isinstance(interrupt, Terminated) else "interrupted"


@contextmanager
def raised_as_exceptions() -> Iterator[None]:
    """Raise :class:`Terminated` on SIGTERM and SIGHUP while the block runs.

    Signals after the first one are ignored, so that they do not interrupt the clean-up. A signal
    that the caller ignores (nohup) remains ignored.
    """
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [signal.Signals[name] for name in names]
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers, and only it receives signals
        return

    def end(number: int, _frame: FrameType | None) -> None:
        for other in before:
            signal.signal(other, signal.SIG_IGN)
        raise Terminated(signal.Signals(number))

    before = {
        number: signal.getsignal(number)
        for number in numbers
        if signal.getsignal(number) == signal.SIG_DFL
    }
    try:
        for number in before:
            signal.signal(number, end)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
