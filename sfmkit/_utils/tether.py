"""Child processes that end with their parent, however the parent ends.

A small guard process, which runs this file as a script, starts the child. The guard has one end of
a pipe, and the parent has the other. When the parent ends, even by SIGKILL, the system closes its
end, and the guard terminates the child: first with SIGTERM and, after some seconds, with SIGKILL.
On Linux, the child is also terminated if the guard itself is killed.

This module imports only the standard library, so that the guard starts quickly.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

__all__ = ["Tethered", "start"]

_PATIENCE_S = 10.0  # JupyterLab needs some seconds to end its kernels
_PR_SET_PDEATHSIG = 1  # option of prctl in Linux


class Tethered:
    """A child process that ends with this process.

    Attributes:
        process: The guard, whose exit status is that of the child.
    """

    def __init__(self, process: subprocess.Popen, pipe: int | None) -> None:
        self.process = process
        self._pipe = pipe

    def poll(self) -> int | None:
        """Return the exit status of the child, or None while it runs."""
        return self.process.poll()

    def wait(self) -> int:
        """Wait until the child has ended, and return its exit status."""
        return self.process.wait()

    def end(self) -> None:
        """Terminate the child, and wait until it has ended."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        elif os.name != "posix":
            self.process.terminate()
        self.process.wait()


def start(
    command: Sequence[str],
    env: Mapping[str, str] | None = None,
    *,
    session: bool = False,
    **streams: Any,
) -> Tethered:
    """Start a command that ends with this process.

    Args:
        command: Program and arguments.
        env: Environment; None for that of this process.
        session: Whether to run it in a new session. The children of the child are then terminated
            with it, and Ctrl-C does not reach them. Otherwise, the child shares the terminal.
        streams: ``stdin``, ``stdout``, ``stderr`` as for :class:`subprocess.Popen`.
    """
    if os.name != "posix":
        return Tethered(subprocess.Popen(command, env=env, **streams), None)
    theirs, ours = os.pipe()
    try:
        guard = [sys.executable, "-I", "-S", __file__, str(theirs), str(int(session)), *command]
        process = subprocess.Popen(guard, env=env, pass_fds=(theirs,), **streams)
    except BaseException:
        os.close(ours)
        raise
    finally:
        os.close(theirs)
    return Tethered(process, ours)


def _guard(pipe: int, session: bool, command: Sequence[str]) -> int:
    """Run `command` until it ends or the other end of the pipe is closed."""
    # Signals from the terminal are meant for the child and for the parent, which then closes the
    # pipe. The child inherits that SIGHUP is ignored, so that it is terminated by the guard.
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    child = subprocess.Popen(command, preexec_fn=_prepare_child, start_new_session=session)
    while child.poll() is None:
        ready, _, _ = select.select([pipe], [], [], 0.05)
        if ready and not os.read(pipe, 1):
            _end(child, session)
    return child.returncode if child.returncode >= 0 else 128 - child.returncode


def _prepare_child() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform.startswith("linux"):
        import ctypes

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _end(child: subprocess.Popen, session: bool) -> None:
    send = (lambda number: os.killpg(child.pid, number)) if session else child.send_signal
    for number in (signal.SIGTERM, signal.SIGKILL):
        deadline = time.monotonic() + _PATIENCE_S
        with suppress(ProcessLookupError, PermissionError):  # all processes have ended
            send(number)
            while time.monotonic() < deadline and (child.poll() is None or session):
                send(0)  # for a session, until its last process has ended
                time.sleep(0.02)


if __name__ == "__main__":
    sys.exit(_guard(int(sys.argv[1]), sys.argv[2] == "1", sys.argv[3:]))
