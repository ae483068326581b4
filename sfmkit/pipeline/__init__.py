"""The stages composed: two photographs to geometry and a cloud, or to a homography."""

from .account import OperatorAccount
from .reconstruction import Reconstruction, reconstruct
from .registration import Registration, register

__all__ = ["OperatorAccount", "Reconstruction", "Registration", "reconstruct", "register"]
