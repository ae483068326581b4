"""The versions of the code: part of every key, and compared between a sweep and its workers."""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

from .._version import __version__

_ROOT = Path(__file__).parent.parent
_SHOWN = {
    "numpy": "numpy",
    "torch": "torch",
    "kornia": "kornia",
    "opencv": "opencv-contrib-python-headless",
}

# stage -> the packages that compute it; what these import is found in their sources
STAGES = {
    "features": ("features", "io"),
    "pairs": ("datasets",),
    "matches": ("matching",),
    "estimates": ("estimation", "pipeline"),
    "geometries": ("matching", "estimation", "pipeline"),
}
# modules that call the stages
_ALWAYS = tuple(Path(__file__).with_name(name) for name in ("stages.py", "geometries.py"))


@cache
def stage_version(stage: str) -> str:
    """Compute a digest of the source files that a stage imports and of their libraries."""
    sources, libraries = dependencies(stage)
    installed = {name: _installed(name) for name in libraries}
    digest = hashlib.sha256(json.dumps([__version__, installed], sort_keys=True).encode())
    for file in sources:
        digest.update(file.relative_to(_ROOT).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def dependencies(stage: str) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Find what the results of a stage depend on.

    Whole packages of sfmkit are followed, because some modules are imported by a name in a table.

    Returns:
        The source files, and the top-level modules of other distributions.
    """
    waiting, found = [*STAGES[stage]], set(STAGES[stage])
    libraries: set[str] = set()
    files = [*_ALWAYS]
    while waiting:
        for file in _files(waiting.pop()):
            files.append(file)
            own, others = imports_of(file)
            libraries |= others
            waiting += own - found
            found |= own
    return tuple(sorted(files)), tuple(sorted(libraries))


@cache
def imports_of(file: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Find what a source file of sfmkit imports, also in functions.

    Returns:
        The packages and modules directly below sfmkit, and the top-level modules of other
        distributions.
    """
    own, others = set(), set()
    package = ("sfmkit", *file.relative_to(_ROOT).parent.parts)
    for node in _nodes(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Constant) and _is_module(node.value):
            names = [str(node.value)]  # a module that is imported by its name: "poselib"
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (base, node.module)))
            names = [f"{module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            first, *rest = name.split(".")
            if first != "sfmkit":
                others.add(first)
            elif rest and any(True for _ in _files(rest[0])):
                own.add(rest[0])
    return frozenset(own), frozenset(others - sys.stdlib_module_names)


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes except those under ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _nodes(node)


def _files(name: str) -> Iterator[Path]:
    """The source files of a package or module directly below sfmkit."""
    if (_ROOT / name).is_dir():
        yield from sorted((_ROOT / name).rglob("*.py"))
    elif (_ROOT / f"{name}.py").is_file():
        yield _ROOT / f"{name}.py"


def _installed(module: str) -> list[str]:
    """The distributions that provide a top-level module, with their versions."""
    names = sorted(set(_distributions().get(module, ())))
    return [f"{name} {version(name)}" for name in names]


def _is_module(value: Any) -> bool:
    return isinstance(value, str) and value in _distributions()


@cache
def _distributions() -> dict[str, list[str]]:
    return dict(packages_distributions())


@cache
def versions() -> dict[str, str]:
    """Versions of sfmkit and of the libraries that it computes with, for tables and messages."""
    found = {"sfmkit": __version__}
    for name, distribution in _SHOWN.items():
        try:
            found[name] = version(distribution)
        except PackageNotFoundError:
            continue
    return found


@cache
def engine_version() -> str:
    """Describe what workers must share with their sweep: versions and the code of the stages."""
    code = hashlib.sha256("".join(stage_version(stage) for stage in STAGES).encode())
    shown = " ".join(f"{name} {v}" for name, v in versions().items())
    return f"{shown}, code {code.hexdigest()[:12]}"


def digest(*parts: Any) -> str:
    """Hexadecimal sha256 of JSON values, 40 characters."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:40]
