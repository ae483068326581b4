"""The plug-ins of a sweep: found when it is planned, loaded by every worker."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from .._utils.registry import Registry
from ..errors import InputError
from ..estimation import ESTIMATOR_PLUGINS
from ..features import OPERATOR_PLUGINS
from ..matching import MATCHER_PLUGINS

OPERATOR, MATCHER, ESTIMATOR = "operator", "matcher", "estimator"
REGISTRIES: Mapping[str, Registry[Any]] = {
    OPERATOR: OPERATOR_PLUGINS,
    MATCHER: MATCHER_PLUGINS,
    ESTIMATOR: ESTIMATOR_PLUGINS,
}


@dataclass(frozen=True)
class PlugIn:
    """A plug-in as tasks and workers refer to it.

    Attributes:
        kind: :data:`OPERATOR`, :data:`MATCHER` or :data:`ESTIMATOR`.
        name: The name in tables and options.
        path: The name by which another process loads it.
        code: Distribution, version, and digests of the sources and of weights.
    """

    kind: str
    name: str
    path: str
    code: str


def find_plugin(kind: str, name: str) -> PlugIn:
    """The plug-in of a name.

    Raises:
        InputError: There is none, it cannot be loaded, or no other process could import it.
    """
    registry = REGISTRIES[kind]
    path = registry.import_path(name)
    return PlugIn(kind, name, path, registry.provenance(name))


def load_plugins(plugins: Iterable[PlugIn]) -> str:
    """Make the plug-ins of a sweep available in this process.

    Returns:
        What is wrong; empty where all are loaded and have the code that the sweep was planned with.
    """
    for plugin in plugins:
        try:
            code = _loaded_code(plugin.kind, plugin.name, plugin.path)
        except InputError as error:
            return f"{error}; install the package of the plug-in on every worker"
        if code != plugin.code:
            return (
                f"{plugin.kind} '{plugin.name}' is {code} here, the sweep was planned with "
                f"{plugin.code}; install the same version everywhere and restart the workers"
            )
    return ""


@cache  # of the code that this process has imported: the file may be edited later
def _loaded_code(kind: str, name: str, path: str) -> str:
    registry = REGISTRIES[kind]
    if name != path:
        plugin = registry[path]
        registry.unregister(name)
        registry.register(name, plugin)
    return registry.provenance(name)
