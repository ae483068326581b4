"""Run the Rerun viewer as a process: in a window, or served to a browser.

It listens on the loopback interface only.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from .._utils import tether
from ..errors import SfmError
from .read import read_recording

HOST = "127.0.0.1"
_COMMAND = (sys.executable, "-m", "rerun_cli", "--bind", HOST)


class ViewerError(SfmError):
    """The viewer cannot be opened here."""


@dataclass(frozen=True)
class Server:
    """A served recording.

    Attributes:
        url: to open in a browser.
        web_port, data_port: ports of the page and of its data.
        process: of the server.
    """

    url: str
    web_port: int
    data_port: int
    process: tether.Tethered

    def wait(self) -> None:
        """Wait until the process ends or is interrupted."""
        self.process.wait()


def open_window(path: str | Path) -> None:
    """Show a recording in a window, and return when it is closed.

    Raises:
        RecordingError: the file cannot be read.
        ViewerError: no display is available, or the viewer failed.
    """
    read_recording(path)
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise ViewerError(
            f"there is no display to open a window on; `sfmkit view --web {path}` serves it to a "
            "browser"
        )
    process = tether.start([*_COMMAND, "--port", "auto", str(path)], session=True)
    try:
        status = process.wait()
    finally:
        process.end()
    if status:
        raise ViewerError(
            f"the viewer ended with status {status}; `sfmkit view --web {path}` serves it to a "
            "browser"
        )


@contextmanager
def serve(path: str | Path, timeout_s: float = 30) -> Iterator[Server]:
    """Serve a recording and the viewer's page on free ports until the block ends.

    Raises:
        RecordingError: the file cannot be read.
        ViewerError: the server did not start.
    """
    read_recording(path)
    web, data = free_ports(2)
    process = tether.start(
        [*_COMMAND, "--serve-web", "--web-viewer-port", str(web), "--port", str(data), str(path)],
        session=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + timeout_s
        while not (listens(web) and listens(data)):
            if process.poll() is not None or time.monotonic() > deadline:
                raise ViewerError(f"the viewer's server did not start within {timeout_s:.0f} s")
            time.sleep(0.05)
        source = quote(f"rerun+http://{HOST}:{data}/proxy", safe="")
        yield Server(f"http://{HOST}:{web}/?url={source}", web, data, process)
    finally:
        process.end()


def free_ports(n: int) -> list[int]:
    """Find n different free ports of the loopback interface."""
    sockets = [socket.socket() for _ in range(n)]
    try:
        for s in sockets:
            s.bind((HOST, 0))
        return [s.getsockname()[1] for s in sockets]
    finally:
        for s in sockets:
            s.close()


def listens(port: int) -> bool:
    """Return whether a server accepts connections at a port of the loopback interface."""
    try:
        socket.create_connection((HOST, port), 0.5).close()
    except OSError:
        return False
    return True
