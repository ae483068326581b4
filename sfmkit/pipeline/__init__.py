"""The complete pipeline: from two photographs to a geometry and a cloud, or a homography."""

from .account import OperatorAccount
from .reconstruction import Reconstruction, reconstruct
from .registration import Registration, register
from .stages import estimate_geometry

__all__ = [
    "OperatorAccount",
    "Reconstruction",
    "Registration",
    "estimate_geometry",
    "reconstruct",
    "register",
]
