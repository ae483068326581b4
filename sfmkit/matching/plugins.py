"""The extension point for matchers: contract, registry, and choice per operator."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from .._utils.registry import Registry, accepted
from ..errors import InputError
from ..features import OPERATOR_PLUGINS
from ..options import MatchOptions
from ..types import Features, Matches
from .learned import lightglue
from .nearest import match

F = TypeVar("F", bound=Callable)


class Matcher(Protocol):
    """A matcher of the features of two images.

    A plug-in is a callable ``(features1, features2, **options) -> Matches``. A matcher with a
    parameter ``mutual``, ``max_ratio``, ``max_distance`` or ``device`` gets the value of
    :class:`~sfmkit.options.MatchOptions` or the torch device; its own options come from
    ``MatchOptions.overrides``. The same input must give the same output.
    """

    def __call__(self, features1: Features, features2: Features, /, **options: Any) -> Matches:
        """Match the features of two images.

        Args:
            features1, features2: N1 and N2 features of one operator in image 1 and image 2.
            options: The matcher's own options.

        Returns:
            M matches. The indices are rows of `features1` and `features2`, each pair at most once.
            The distance is that of the descriptors or any other cost that is smaller for a better
            match. The ratio is that of the best to the second-best distance, or NaN if the matcher
            has none.
        """


OTHER_OPERATORS = "*"  # key for all operators that a mapping operator -> matcher does not name
MATCHER_PLUGINS: Registry[Callable[..., Matches]] = Registry("matcher", "sfmkit.matchers")
MATCHER_PLUGINS.register("nearest", match)
MATCHER_PLUGINS.register("lightglue", lightglue)


def register_matcher(name: str, matcher: F) -> F:
    """Register a matcher under a name, for this process.

    Args:
        name: Name of the matcher in ``matchers=``, ``--matcher`` and reports.
        matcher: A callable that fulfils the contract of :class:`Matcher`.

    Returns:
        `matcher`.

    Raises:
        InputError: `matcher` is not callable, or the name is malformed or taken.
    """
    MATCHER_PLUGINS.register(name, matcher)
    return matcher


def matcher_of(operator: str, options: MatchOptions) -> str:
    """Return the name of the matcher that the options select for an operator."""
    return options.matchers.get(operator, options.matcher)


def canonical_matchers(
    matchers: str | Mapping[str, str] | None,
) -> str | Mapping[str, str] | None:
    """Replace the names of operators in a choice of matchers by their canonical names.

    Args:
        matchers: As for :func:`choose_matchers`; the key ``"*"`` is kept.

    Raises:
        OperatorError: An operator is unknown.
    """
    if not isinstance(matchers, Mapping):
        return matchers
    return {
        name if name == OTHER_OPERATORS else OPERATOR_PLUGINS.canonical(name): matcher
        for name, matcher in matchers.items()
    }


def choose_matchers(
    options: MatchOptions, matchers: str | Mapping[str, str] | None
) -> MatchOptions:
    """Return the options with other matchers.

    Args:
        options: Options of the matching.
        matchers: The name of a matcher for all operators, or a mapping operator -> matcher for
            some, with the key ``"*"`` for all others; None keeps those of the options.
    """
    if matchers is None:
        return options
    if isinstance(matchers, str):
        return replace(options, matcher=matchers, matchers={})
    some = {name: matcher for name, matcher in matchers.items() if name != OTHER_OPERATORS}
    return replace(
        options,
        matcher=matchers.get(OTHER_OPERATORS, options.matcher),
        matchers={**options.matchers, **some},
    )


def run_matcher(
    features1: Features,
    features2: Features,
    options: MatchOptions | None = None,
    *,
    operator: str | None = None,
    device: Any = None,
) -> Matches:
    """Run the matcher that the options select, and check that its result fulfils the contract.

    Args:
        features1, features2: N1 and N2 features of one operator.
        options: Options of the matching.
        operator: Name of the operator in the options; ``features1.operator`` by default.
        device: Torch device, for matchers with such a parameter.

    Raises:
        InputError: There is no such matcher, it fails, or its result is invalid.
    """
    options = options or MatchOptions()
    operator = features1.operator if operator is None else operator
    name = matcher_of(operator, options)
    common = {
        "mutual": options.mutual,
        "max_ratio": options.max_ratio,
        "max_distance": options.max_distance,
        "device": device,
    }
    own = options.overrides.get(operator, {})
    settings = accepted(MATCHER_PLUGINS[name], common, rest=False) | dict(own)
    found = MATCHER_PLUGINS.call(name, features1, features2, **settings)
    reason = _fault(found, len(features1), len(features2))
    if reason:
        raise MATCHER_PLUGINS.reject(name, found, reason)
    return found


def _fault(found: Any, n1: int, n2: int) -> str:
    """Describe what is wrong with the result of a matcher; empty if it is valid."""
    if not isinstance(found, Matches):
        return "it must be Matches"
    for field, n in (("index1", n1), ("index2", n2)):
        rows = getattr(found, field)
        if len(rows) and not (rows.min() >= 0 and rows.max() < n):
            return f"{field} points outside the {n} features"
    pairs = found.index1.astype(np.int64) * max(n2, 1) + found.index2
    if len(np.unique(pairs)) < len(pairs):
        return "a pair of features occurs more than once"
    return ""


@dataclass(frozen=True)
class MatcherInfo:
    """A row of the table of matchers.

    Attributes:
        name: Name in ``matchers=`` and ``--matcher``.
        operators: The operators whose features it matches, in words.
        available, reason: Whether it can run here and, if not, what to install.
        licence: Licence of the code and weights; for a plug-in, the provenance of its code.
        summary: Description in one line.
    """

    name: str
    operators: str
    available: bool
    reason: str
    licence: str
    summary: str


def list_matchers() -> list[MatcherInfo]:
    """List all registered and installed matchers."""
    return [_info(name) for name in MATCHER_PLUGINS]


def _info(name: str) -> MatcherInfo:
    try:
        matcher = MATCHER_PLUGINS[name]
    except InputError as error:  # an entry point that cannot be loaded
        return MatcherInfo(name, "?", False, str(error), "?", "")
    usable, reason = getattr(matcher, "available", lambda: (True, ""))()
    document = (inspect.getdoc(matcher) or "").partition("\n")[0]
    return MatcherInfo(
        name,
        getattr(matcher, "operators", "all"),
        usable,
        reason,
        getattr(matcher, "licence", None) or MATCHER_PLUGINS.provenance(name),
        getattr(matcher, "summary", document),
    )
