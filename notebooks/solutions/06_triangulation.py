"""Solutions of notebook 06."""

import numpy as np

from sfmkit.teaching import check


def depth(f, b, d):
    return f * b / d


def depth_sigma(z, f, b, sigma):
    # |dz/dd| = f b / d^2, and d = f b / z
    return z**2 / (f * b) * sigma


def midpoint(c1, d1, c2, d2):
    # a d1 - b d2 = c2 - c1 in the least-squares sense: the shortest segment is
    # perpendicular to both rays
    (a, b), *_ = np.linalg.lstsq(np.column_stack([d1, -d2]), c2 - c1, rcond=None)
    return (c1 + a * d1 + c2 + b * d2) / 2


def angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


check("06.1", depth)
check("06.2", depth_sigma)
check("06.3", midpoint)
check("06.4", angle)
