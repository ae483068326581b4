"""Answer questions about a recording: pixels, matches, points, operators, differences.

Reads what :func:`sfmkit.recording.save_recording` wrote; docs/recording.md describes the entities.
"""

from .difference import diff_recordings
from .lives import Life, keypoint_life, match_life, point_life
from .overview import describe_entity, describe_operator, describe_recording
from .questions import (
    Rejection,
    describe_match,
    describe_pixel,
    describe_point,
    describe_rejected,
    rejections,
)
from .tables import Tables, read_tables

__all__ = [
    "Life",
    "Rejection",
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
    "point_life",
    "read_tables",
    "rejections",
]
