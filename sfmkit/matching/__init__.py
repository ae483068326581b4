"""Stage 2, Features -> Matches -> Correspondences: nearest neighbours, guided matching, fusion."""

from .fusion import fuse
from .guided import match_guided
from .nearest import match
from .plugins import MATCHER_PLUGINS, Matcher, choose_matchers, register_matcher, run_matcher

__all__ = [
    "MATCHER_PLUGINS",
    "Matcher",
    "choose_matchers",
    "fuse",
    "match",
    "match_guided",
    "register_matcher",
    "run_matcher",
]
