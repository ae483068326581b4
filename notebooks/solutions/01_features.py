"""Solutions of notebook 01."""

import numpy as np

from sfmkit.teaching import check


def is_fast_corner(ring, centre, threshold):
    for on in (ring > centre + threshold, ring < centre - threshold):
        around = np.concatenate([on, on[:8]])  # pixel 15 is next to pixel 0
        if any(around[k : k + 9].all() for k in range(16)):
            return True
    return False


def harris(A, k):
    return np.linalg.det(A) - k * np.trace(A) ** 2


def box_sum(S, x0, y0, x1, y1):
    return S[y1, x1] - S[y0, x1] - S[y1, x0] + S[y0, x0]


def orientation(patch):
    r = len(patch) // 2
    y, x = np.mgrid[-r : r + 1, -r : r + 1]
    return np.arctan2((y * patch).sum(), (x * patch).sum())


check("01.1", is_fast_corner)
check("01.2", harris)
check("01.3", box_sum)
check("01.4", orientation)
