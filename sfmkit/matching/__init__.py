"""Stage 2, Features -> Matches -> Correspondences: nearest neighbours, guided matching, fusion."""

from .fusion import fuse
from .guided import match_guided
from .nearest import match

__all__ = ["fuse", "match", "match_guided"]
