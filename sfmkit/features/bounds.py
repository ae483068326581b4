"""Bounds of the options of the operators, per parameter of OpenCV's factories.

OpenCV 5.0 checks few of its parameters: for some values, it divides by zero, reads outside an
array, or needs minutes for a small image. The bounds exclude these values and include all values in
common use. They were determined, and are tested, by running every operator at both ends of every
option in a child process (tests/features/test_bounds.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

__all__ = ["BOUNDS", "Range", "bounds_of"]

Range = tuple[float, float]  # the smallest and the largest accepted value

_MOST = 10_000_000  # keypoints; ORB and SIFT allocate memory for the requested number
_GREY = (0, 255)  # a difference of grey values
_EIGENVALUE: Mapping[str, Range] = {
    "maxCorners": (0, _MOST),
    "qualityLevel": (1e-12, 1.0),  # OpenCV does not accept 0
    "minDistance": (0.0, 100_000.0),  # at 2^31 - 1 OpenCV crashes
    "blockSize": (1, 63),
    "k": (0.0, 1.0),
}

# detector or descriptor -> option -> bounds
BOUNDS: Mapping[str, Mapping[str, Range]] = {
    "surf": {"hessian_threshold": (0.0, 1e9), "octaves": (1, 16), "layers": (1, 16)},
    "orb": {
        "nfeatures": (0, _MOST),
        "scaleFactor": (1.01, 8.0),
        "nlevels": (1, 16),
        "edgeThreshold": (0, 1000),
        "patchSize": (2, 255),  # the time grows with its square
        "fastThreshold": _GREY,
    },
    "fast": {"threshold": _GREY},
    "agast": {"threshold": _GREY},
    "harris": _EIGENVALUE,
    "gftt": _EIGENVALUE,
    "sift": {
        "nfeatures": (0, _MOST),
        "nOctaveLayers": (1, 16),
        "contrastThreshold": (0.0, 10.0),
        "edgeThreshold": (0.0, 1e6),
        "sigma": (0.1, 10.0),  # the time grows with it: 10 s for 640 x 480 pixels at 100
    },
    "akaze": {"threshold": (0.0, 10.0), "nOctaves": (1, 16), "nOctaveLayers": (1, 16)},
    # the time doubles with every octave, however small the image: 1 s for 180 x 130 pixels at 8
    "kaze": {"threshold": (0.0, 10.0), "nOctaves": (1, 8), "nOctaveLayers": (1, 16)},
    "brisk": {"thresh": _GREY, "octaves": (0, 8), "patternScale": (0.1, 100.0)},
    "star": {
        "maxSize": (4, 128),
        "responseThreshold": (0, 1_000_000),
        "lineThresholdProjected": (0, 1_000_000),
        "lineThresholdBinarized": (0, 1_000_000),
        "suppressNonmaxSize": (1, 7),  # OpenCV reads outside the image at 15 with a maxSize of 4
    },
    "mser": {
        "delta": _GREY,
        "min_area": (6, 1_000_000_000),  # smaller regions have no ellipse in OpenCV
        "max_area": (1, 1_000_000_000),
        "max_variation": (0.0, 1e6),
        "min_diversity": (0.0, 1e6),
    },
    "brief": {"bytes": (16, 64)},
    "freak": {"patternScale": (0.1, 100.0), "nOctaves": (1, 16)},
    "latch": {"bytes": (1, 64), "half_ssd_size": (0, 16), "sigma": (0.0, 100.0)},
    "beblid": {"scale_factor": (0.1, 100.0)},
    "teblid": {"scale_factor": (0.1, 100.0)},
    "boost": {"scale_factor": (0.1, 100.0)},
    "daisy": {
        "radius": (1.0, 100.0),
        "q_radius": (1, 16),
        "q_theta": (1, 16),
        "q_hist": (1, 16),
    },
    "vgg": {"isigma": (0.1, 100.0), "scale_factor": (0.1, 100.0)},
}

TILTS: Range = (0, 6)  # 62 views for 6; for 12, the simulated views would be compressed 64 times


def bounds_of(detector: str, descriptor: str, option: str) -> Range:
    """Return the smallest and largest accepted values of an option of an operator.

    An option that both parts of ``detector+descriptor`` have belongs to the detector. Options
    without a row, such as those of plug-ins, must only be finite and not negative.
    """
    for part in (detector, descriptor.removeprefix("root")):
        if option in BOUNDS.get(part, {}):
            return BOUNDS[part][option]
    return TILTS if option == "tilts" else (0, math.inf)
