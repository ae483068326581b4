"""Stage 2, Features -> Matches -> Correspondences: matching and fusion."""

from .fusion import absorb, find_leaders, fuse, represent
from .guided import match_guided
from .nearest import match
from .plugins import (
    MATCHER_PLUGINS,
    Matcher,
    MatcherInfo,
    canonical_matchers,
    choose_matchers,
    list_matchers,
    matcher_of,
    register_matcher,
    run_matcher,
)

__all__ = [
    "MATCHER_PLUGINS",
    "Matcher",
    "MatcherInfo",
    "absorb",
    "canonical_matchers",
    "choose_matchers",
    "find_leaders",
    "fuse",
    "list_matchers",
    "match",
    "match_guided",
    "matcher_of",
    "register_matcher",
    "represent",
    "run_matcher",
]
