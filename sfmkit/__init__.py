"""sfmkit: two-view structure from motion that fuses several feature detectors and explains itself."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# name -> module that defines it. Imported on first use: `import sfmkit` costs milliseconds, torch over a second.
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
    "read_image": "images",
    "camera_from_exif": "cameras",
    "detect": "features",
    "OPERATORS": "features",
    "match": "matching",
    "fuse": "fusion",
    "estimate_two_view": "estimation",
    "reconstruct": "pipeline",
    "Reconstruction": "pipeline",
    "register": "registration",
    "Registration": "registration",
}
__all__ = ["__version__", *_PUBLIC]

if TYPE_CHECKING:
    from .errors import DegenerateGeometryError, InputError, SfmError
    from .estimation import estimate_two_view
    from .features import OPERATORS, detect
    from .fusion import fuse
    from .images import read_image
    from .matching import match
    from .pipeline import Reconstruction, reconstruct
    from .registration import Registration, register
    from .types import Camera, Correspondences, Features, Matches, PointCloud, TwoView, Verdict


def __getattr__(name: str):
    if name in _PUBLIC:
        value = getattr(import_module(f".{_PUBLIC[name]}", __name__), name)
        # Not cached for `match`-like names that are modules too: the module attribute is set by the import system.
        globals()[name] = value
        return value
    raise AttributeError(f"module 'sfmkit' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
