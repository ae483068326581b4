"""Answer questions about a recording in text: points, operators, entities, differences.

Reads what :func:`sfmkit.recording.save_recording` wrote; docs/recording.md describes the entities.
"""

from .difference import diff_recordings
from .overview import describe_entity, describe_operator, describe_recording
from .points import PointOrigin, Sighting, describe_point, point_origin

__all__ = [
    "PointOrigin",
    "Sighting",
    "describe_entity",
    "describe_operator",
    "describe_point",
    "describe_recording",
    "diff_recordings",
    "point_origin",
]
