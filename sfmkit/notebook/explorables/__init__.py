"""Interactive figures that run in the browser, with or without a kernel."""

from .explorable import Explorable
from .homography_or_depth import HomographyOrDepth
from .ransac import RansacSteps
from .two_cameras import TwoCameras

__all__ = ["Explorable", "HomographyOrDepth", "RansacSteps", "TwoCameras"]
