"""Join ES modules to one: widgets and self-contained pages load a single module."""

from __future__ import annotations

import re
from importlib.resources import files

__all__ = ["bundle", "style"]

_FOLDER = files(__package__) / "js"
_IMPORT = re.compile(r'^import\s*\{[^}]*\}\s*from\s*"\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=const|let|function|class)", re.MULTILINE)


def bundle(name: str) -> str:
    """Return ``js/NAME.js`` preceded by all modules that it imports, as one ES module.

    The modules import each other with ``import { ... } from "./MODULE.js";`` only, and no two
    define the same name at the top level.
    """
    return "\n".join(_with_imports(name, set()))


def style() -> str:
    """Return the style sheet of all explorables."""
    return (_FOLDER / "style.css").read_text(encoding="utf-8")


def _with_imports(name: str, seen: set[str]) -> list[str]:
    """The sources of a module and of its imports that have not been seen, imports first."""
    if name in seen:
        return []
    seen.add(name)
    source = (_FOLDER / f"{name}.js").read_text(encoding="utf-8")
    imported = [part for other in _IMPORT.findall(source) for part in _with_imports(other, seen)]
    return [*imported, _EXPORT.sub("", _IMPORT.sub("", source))]
