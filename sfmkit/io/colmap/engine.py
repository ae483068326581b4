"""The optional dependency pycolmap."""

from __future__ import annotations

import signal
import threading
from importlib import import_module
from typing import Any

from ...errors import InputError

__all__ = ["pycolmap_module"]


def pycolmap_module() -> Any:
    """Import pycolmap with its log switched off.

    pycolmap installs a handler of SIGTERM that prints a stack trace and ends the process at once,
    without any clean-up. The handler of this process is set again.

    Raises:
        InputError: It is not installed.
    """
    try:
        module = import_module("pycolmap")
    except ImportError as error:
        raise InputError(
            "pycolmap is not installed; it comes with the peers extra: pip install 'sfmkit[peers]'"
        ) from error
    module.logging.minloglevel = 3  # its failures are returned as values
    handler = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is threading.main_thread() and handler is not None:
        signal.signal(signal.SIGTERM, handler)
    return module
