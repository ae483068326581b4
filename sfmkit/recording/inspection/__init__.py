"""Answer questions about a recording: pixels, matches, points, operators, differences.

Reads what :func:`sfmkit.recording.save_recording` wrote; docs/recording.md describes the entities.
"""

from .difference import diff_recordings
from .lives import Life, keypoint_life, match_life
from .overview import describe_entity, describe_operator, describe_recording
from .points import PointOrigin, Sighting, describe_point, point_origin
from .questions import (
    Rejection,
    describe_match,
    describe_pixel,
    describe_rejected,
    rejections,
)
from .tables import Tables, read_tables

__all__ = [
    "Life",
    "PointOrigin",
    "Rejection",
    "Sighting",
    "Tables",
    "describe_entity",
    "describe_match",
    "describe_operator",
    "describe_pixel",
    "describe_point",
    "describe_recording",
    "describe_rejected",
    "diff_recordings",
    "keypoint_life",
    "match_life",
    "point_origin",
    "read_tables",
    "rejections",
]
