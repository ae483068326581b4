"""Registry of plug-ins by name, entry point or import path."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points, packages_distributions, version
from pathlib import Path
from typing import Any, Generic, TypeVar

from .._version import __version__
from ..errors import InputError, SfmError

T = TypeVar("T", bound=Callable)


class Registry(Generic[T]):
    """The plug-ins of one kind.

    A plug-in is found, in this order, by the name under which it was registered, by the name of an
    installed entry point, or by an import path ``package.module:name``.

    Args:
        kind: Kind of the plug-ins in the singular, for messages, such as ``operator``.
        group: Entry-point group of installed packages, such as ``sfmkit.operators``.
        error: Exception class for a name that is not found or a plug-in that cannot be loaded.
    """

    def __init__(self, kind: str, group: str, error: type[InputError] = InputError) -> None:
        self.kind, self.group, self.error = kind, group, error
        self._registered: dict[str, T] = {}

    def register(self, name: str, plugin: T) -> T:
        """Register a plug-in under a name.

        Registering the same plug-in again under this name has no effect.

        Raises:
            InputError: `plugin` is not callable, the name is malformed, or it is taken by another.
        """
        if not callable(plugin):
            raise InputError(f"{self.kind} '{name}' must be callable, not {type(plugin).__name__}")
        if not name or not name.isprintable() or set(name) & set(" ,:=/\\"):
            raise InputError(
                f"{name!r} cannot be the name of a plug-in: spaces and , : = / \\ are not allowed"
            )
        if self._registered.setdefault(name, plugin) is not plugin:
            raise InputError(f"there is already another {self.kind} '{name}'")
        return plugin

    def unregister(self, name: str) -> None:
        """Remove a registered name; for tests and notebooks that replace a plug-in."""
        self._registered.pop(name, None)

    def __contains__(self, name: str) -> bool:
        return name in self._registered or name in self._entry_points or ":" in name

    def __iter__(self) -> Iterator[str]:
        """Iterate over the registered names, then over those of entry points."""
        return iter(dict.fromkeys([*self._registered, *self._entry_points]))

    def __getitem__(self, name: str) -> T:
        """Return the plug-in called `name`.

        Raises:
            InputError: There is no such plug-in, or it cannot be loaded. The class is that of the
                registry.
        """
        if name in self._registered:
            return self._registered[name]
        if name not in self._entry_points and ":" not in name:
            near = get_close_matches(name, list(self), n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise self.error(f"unknown {self.kind} '{name}'.{hint} Known: {', '.join(self)}")
        try:
            if name in self._entry_points:
                plugin = self._entry_points[name].load()
            else:
                module, _, attribute = name.partition(":")
                plugin = import_module(module)
                for part in attribute.split("."):
                    plugin = getattr(plugin, part)
        except Exception as error:  # a plug-in's module may raise anything when it is imported
            reason = f"{type(error).__name__}: {error}"
            raise self.error(f"cannot load {self.kind} '{name}': {reason}") from error
        if not callable(plugin):
            raise self.error(f"{self.kind} '{name}' is a {type(plugin).__name__}, not callable")
        return plugin

    def canonical(self, name: str) -> str:
        """Return the name under which results of the plug-in are stored.

        Raises:
            InputError: There is no such plug-in.
        """
        self[name]
        return name

    def call(self, name: str, *args: Any, **keywords: Any) -> Any:
        """Call a plug-in, and name it in the message if it raises an error.

        Raises:
            InputError: A plug-in that is not part of sfmkit raised an error. The class is that of
                the registry. Errors of built-in plug-ins are passed through.
        """
        plugin = self[name]
        try:
            return plugin(*args, **keywords)
        except Exception as error:  # a plug-in may raise anything
            if self.is_built_in(name):
                raise
            kind = "" if isinstance(error, SfmError) else f"{type(error).__name__}: "
            raise self.error(f"{self.kind} '{name}' failed: {kind}{error}") from error

    def reject(self, name: str, result: Any, reason: str) -> InputError:
        """Return the error for a result that breaks the contract; the caller raises it."""
        kind = type(result).__name__
        return self.error(f"{self.kind} '{name}' returned an invalid {kind}: {reason}")

    def import_path(self, name: str) -> str:
        """Return a name under which another process finds the same plug-in.

        Raises:
            InputError: The plug-in is defined in ``__main__``, a notebook or a closure.
        """
        plugin = self[name]
        if name not in self._registered or self.is_built_in(name):
            return name
        module, qualname = _place(self._code(plugin))
        try:
            found = import_module(module)
            for part in qualname.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError, ValueError):
            found = None
        if module == "__main__" or found is not plugin:
            raise self.error(
                f"{self.kind} '{name}' cannot be imported by another process "
                f"({module}:{qualname}); define it at the top level of an importable module"
            )
        return f"{module}:{qualname}"

    def is_built_in(self, name: str) -> bool:
        """Return whether the plug-in is part of sfmkit."""
        return _place(self._code(self[name]))[0].split(".")[0] == "sfmkit"

    def provenance(self, name: str) -> str:
        """Identify the code of a plug-in by its distribution, version and source digest.

        The text is part of cache keys and reports. The digest covers every Python file of the
        top-level package of the module, or only the module if it is a single file. A plug-in that
        reads files, such as network weights, identifies them with a method ``provenance() -> str``.
        """
        plugin = self._code(self[name])
        data = getattr(plugin, "provenance", None)
        files = f" {data()}" if data else ""
        if self.is_built_in(name):
            return f"sfmkit {__version__}{files}"
        module, qualname = _place(plugin)
        top = module.split(".")[0]
        distributions = packages_distributions().get(top, [])
        known = ", ".join(f"{d} {version(d)}" for d in sorted(set(distributions)))
        return f"{known or module} {qualname} sha256:{_source_digest(top)}{files}"

    def _code(self, plugin: T) -> Callable:
        """Return the callable that defines the source of a plug-in, unwrapped if necessary."""
        return inspect.unwrap(plugin)

    @cached_property
    def _entry_points(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)}


def accepted(function: Callable, keywords: Mapping[str, Any], *, rest: bool) -> dict[str, Any]:
    """Return the keywords for which a function has a parameter.

    Args:
        function: The function.
        keywords: Names and values of the available keywords.
        rest: Whether ``**options`` of the function receives the other keywords.
    """
    parameters = inspect.signature(function).parameters.values()
    if rest and any(p.kind is p.VAR_KEYWORD for p in parameters):
        return dict(keywords)
    named = {p.name for p in parameters if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)}
    return {name: value for name, value in keywords.items() if name in named}


def _place(plugin: Callable) -> tuple[str, str]:
    """Return the module and the qualified name of a function, class or instance."""
    owner = plugin if hasattr(plugin, "__qualname__") else type(plugin)
    return owner.__module__ or "__main__", owner.__qualname__


def _source_digest(package: str) -> str:
    """Compute the digest of the Python files of a package in their current state."""
    module = sys.modules.get(package)
    try:
        file = Path(inspect.getfile(module)) if module is not None else None
    except TypeError:
        file = None
    if file is None or not file.is_file():
        return "unknown"
    files = sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.relative_to(file.parent).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
