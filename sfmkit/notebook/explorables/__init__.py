"""Interactive figures that compute in the browser, with and without a kernel."""

from .explorable import Explorable
from .two_cameras import TwoCameras

__all__ = ["Explorable", "TwoCameras"]
