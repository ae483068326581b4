"""The optional package h5py."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import InputError

__all__ = ["h5py_module"]


def h5py_module() -> Any:
    """Import h5py.

    Raises:
        InputError: It is not installed.
    """
    try:
        return import_module("h5py")
    except ImportError as error:
        raise InputError(
            "h5py is not installed; it comes with the peers extra: pip install 'sfmkit[peers]'"
        ) from error
