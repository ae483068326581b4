"""Folders of photographs: pairs matched and judged, and handed over to an engine for many views.

>>> from sfmkit.mapping import match_folder
>>> matched = match_folder("photographs")
"""

from .collection import Collection, Photograph, read_collection
from .matched_folder import MatchedFolder, Workshop, match_folder

__all__ = [
    "Collection",
    "MatchedFolder",
    "Photograph",
    "Workshop",
    "match_folder",
    "read_collection",
]
