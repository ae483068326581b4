"""Stage 1, image -> Features: detectors and descriptors behind one call."""

from .operators import OperatorInfo, available, detect, list_operators
from .selection import select_evenly
from .tables import (
    DESCRIPTORS,
    DETECTORS,
    OPERATORS,
    DescriptorSpec,
    DetectorSpec,
    OperatorSpec,
    operator_spec,
)

__all__ = [
    "DESCRIPTORS",
    "DETECTORS",
    "OPERATORS",
    "DescriptorSpec",
    "DetectorSpec",
    "OperatorInfo",
    "OperatorSpec",
    "available",
    "detect",
    "list_operators",
    "operator_spec",
    "select_evenly",
]
