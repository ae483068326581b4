"""Stage 1, image -> Features: detectors and descriptors behind one call."""

from .operators import OperatorInfo, available, detect, list_operators
from .plugins import OPERATOR_PLUGINS, Operator, register_operator, run_operator
from .selection import select_evenly
from .tables import (
    DESCRIPTORS,
    DETECTORS,
    OPERATORS,
    DescriptorSpec,
    DetectorSpec,
    OperatorSpec,
    find_spec,
)

__all__ = [
    "DESCRIPTORS",
    "DETECTORS",
    "OPERATORS",
    "OPERATOR_PLUGINS",
    "DescriptorSpec",
    "DetectorSpec",
    "Operator",
    "OperatorInfo",
    "OperatorSpec",
    "available",
    "detect",
    "find_spec",
    "list_operators",
    "register_operator",
    "run_operator",
    "select_evenly",
]
