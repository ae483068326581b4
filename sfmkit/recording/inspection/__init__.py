"""Questions to a recording, answered in text: where a point comes from, how an operator did, what
differs from another.

Reads what :func:`sfmkit.recording.log.save_recording` wrote; see docs/recording.md for what is in
it.
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
