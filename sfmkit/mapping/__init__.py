"""Folders of photographs: matched and judged pairs, and models of many views by COLMAP.

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
