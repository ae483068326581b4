"""Settings of a benchmark that depend on its operators, matchers and estimator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..options import Options
from ..pipeline.provenance import used_plugins
from .rows import Row

__all__ = ["plugin_settings"]


def plugin_settings(
    operators: Sequence[str],
    options: Options,
    *,
    matchers: str | Mapping[str, str] | None,
    backend: str | None = None,
) -> Row:
    """Return the settings that identify the operators, matchers and estimator of a benchmark.

    Args:
        operators: Canonical names.
        options: Options of the run, which contain the matchers and the estimator.
        matchers: Matchers as the caller chose them, with canonical names of the operators.
        backend: Estimator that the caller chose; None for those of the presets, which are part
            of sfmkit and are not recorded.

    Returns:
        ``operators``, ``matchers`` and ``plugins`` as JSON values; for the last one see
        :func:`sfmkit.pipeline.provenance.used_plugins`.
    """
    plugins = used_plugins(operators, options)
    if backend is None:
        del plugins["estimators"]
    return {
        "operators": list(operators),
        "matchers": dict(matchers) if isinstance(matchers, Mapping) else matchers,
        "plugins": plugins,
    }
