"""Which code made a result: part of every key, and what the engines compare."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from .._version import __version__

_ROOT = Path(__file__).parent.parent
_LIBRARIES = {
    "numpy": "numpy",
    "torch": "torch",
    "kornia": "kornia",
    "opencv": "opencv-contrib-python-headless",
}

# What the results of a stage depend on. Editing a plot makes no feature out of date.
SOURCES = {
    "features": ("features", "io/images.py", "_utils/parallel.py", "types"),
    "pairs": ("datasets",),
    "matches": ("matching", "_utils/parallel.py", "types"),
    "estimates": (
        "ablation/stages.py",
        "estimation",
        "geometry",
        "matching",
        "options.py",
        "pipeline/registration.py",
        "types",
    ),
}


@cache
def stage_version(stage: str) -> str:
    """Digest of the stage's source files and of the libraries it computes with."""
    digest = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    for name in SOURCES[stage]:
        path = _ROOT / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(_ROOT).as_posix().encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def versions() -> dict[str, str]:
    """Versions of sfmkit and of what it computes with."""
    return {
        "sfmkit": __version__,
        **{name: version(package) for name, package in _LIBRARIES.items()},
    }


@cache
def engine_version() -> str:
    """What a worker must have in common with whoever gives it work: versions, and the source of
    every stage."""
    code = hashlib.sha256("".join(stage_version(stage) for stage in SOURCES).encode()).hexdigest()[
        :12
    ]
    return " ".join(f"{name} {v}" for name, v in versions().items()) + f", code {code}"


def digest(*parts: Any) -> str:
    """Hexadecimal sha256 of JSON-able parts."""
    return hashlib.sha256(
        json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()[:40]
