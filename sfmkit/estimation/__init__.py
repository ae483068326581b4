"""Stage 3: robust estimation of H, F and E over interchangeable back ends, and the verdict on what
they mean."""

from .adjust import Adjustment, adjust
from .result import RobustModel
from .two_view import estimate_two_view, undistorted_pixels

__all__ = [
    "Adjustment",
    "RobustModel",
    "adjust",
    "estimate_two_view",
    "undistorted_pixels",
]
