"""Provenance of the operators, matchers and estimator of a run."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimation import ESTIMATOR_PLUGINS
from ..features import OPERATOR_PLUGINS
from ..matching import MATCHER_PLUGINS, matcher_of
from ..options import Options


def used_plugins(operators: Sequence[str], options: Options) -> dict[str, dict[str, str]]:
    """Return texts that identify the code of each plug-in that a run uses.

    Args:
        operators: The operators of the run.
        options: The options of the run, which select the matchers and the estimator.

    Returns:
        ``operators``, ``matchers``, ``estimators`` -> name -> the distribution with its version
        and, if it is not sfmkit, a digest of its source.
    """
    matchers = dict.fromkeys(matcher_of(name, options.match) for name in operators)
    backend = options.estimate.backend
    return {
        "operators": {name: OPERATOR_PLUGINS.provenance(name) for name in operators},
        "matchers": {name: MATCHER_PLUGINS.provenance(name) for name in matchers},
        "estimators": {backend: ESTIMATOR_PLUGINS.provenance(backend)},
    }
