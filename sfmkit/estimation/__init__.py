"""Stage 3: robust estimation of H, F and E over interchangeable back ends, and the verdict on what
they mean."""

from .adjust import Adjustment, adjust
from .focal import FocalEstimate, estimate_focal, estimate_with_focal
from .plugins import (
    ESTIMATOR_PLUGINS,
    Estimator,
    check_estimator,
    register_estimator,
    run_estimator,
)
from .result import RobustModel
from .two_view import estimate_two_view, undistorted_pixels, within_the_field

__all__ = [
    "ESTIMATOR_PLUGINS",
    "Adjustment",
    "Estimator",
    "FocalEstimate",
    "RobustModel",
    "adjust",
    "check_estimator",
    "estimate_focal",
    "estimate_two_view",
    "estimate_with_focal",
    "register_estimator",
    "run_estimator",
    "undistorted_pixels",
    "within_the_field",
]
