"""Solutions of notebook 09."""

import numpy as np

from sfmkit.teaching import check


def focal_px(f35, w, h):
    return f35 / np.hypot(36, 24) * np.hypot(w, h)


def resize(K, s):
    out = K.copy()
    out[:2] *= s
    out[:2, 2] += (s - 1) / 2  # (c + 1/2) s - 1/2 = c s + (s - 1) / 2
    return out


check("09.1", focal_px)
check("09.2", resize)
check("09.3", "turning on the spot")
