"""The optional dependency pycolmap."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ...errors import InputError

__all__ = ["pycolmap_module"]


def pycolmap_module() -> Any:
    """Import pycolmap with its log switched off.

    Raises:
        InputError: It is not installed.
    """
    try:
        module = import_module("pycolmap")
    except ImportError as error:
        raise InputError(
            "pycolmap is not installed; it comes with the peers extra: pip install 'sfmkit[peers]'"
        ) from error
    module.logging.minloglevel = 3  # failures are visible in the return values
    return module
