"""Two-view structure from motion with several feature detectors."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from ._utils.forking import use_one_thread_after_fork
from ._version import __version__

use_one_thread_after_fork()

# Name -> module that defines it. The modules are imported on first use: `import sfmkit` takes
# milliseconds, torch more than a second.
_PUBLIC = {
    "Camera": "types",
    "Features": "types",
    "Matches": "types",
    "Correspondences": "types",
    "TwoView": "types",
    "Verdict": "types",
    "PointCloud": "types",
    "SfmError": "errors",
    "InputError": "errors",
    "DegenerateGeometryError": "errors",
    "read_image": "io.images",
    "camera_from_exif": "io.cameras",
    "detect": "features",
    "OPERATORS": "features",
    "match": "matching",
    "fuse": "matching",
    "register_operator": "features",
    "register_matcher": "matching",
    "register_estimator": "estimation",
    "RobustModel": "estimation",
    "estimate_two_view": "estimation",
    "reconstruct": "pipeline",
    "Reconstruction": "pipeline",
    "register": "pipeline",
    "Registration": "pipeline",
}
__all__ = ["__version__", *_PUBLIC]

if TYPE_CHECKING:
    from .errors import DegenerateGeometryError, InputError, SfmError
    from .estimation import RobustModel, estimate_two_view, register_estimator
    from .features import OPERATORS, detect, register_operator
    from .io.images import read_image
    from .matching import register_matcher
    from .matching.fusion import fuse
    from .matching.nearest import match
    from .pipeline.reconstruction import Reconstruction, reconstruct
    from .pipeline.registration import Registration, register
    from .types import Camera, Correspondences, Features, Matches, PointCloud, TwoView, Verdict


def __getattr__(name: str):
    if name in _PUBLIC:
        value = getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'sfmkit' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
