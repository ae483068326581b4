"""Stage 1, image -> Features: detectors and descriptors behind one call."""

from .lafs import keypoints_from_lafs, lafs_from_features
from .operators import OperatorInfo, available, choose_operators, detect, list_operators
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
    "choose_operators",
    "detect",
    "find_spec",
    "keypoints_from_lafs",
    "lafs_from_features",
    "list_operators",
    "register_operator",
    "run_operator",
    "select_evenly",
]
