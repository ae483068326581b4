"""Solutions of notebook 10."""

import math

import numpy as np

from sfmkit.teaching import check


def samples(p, w, s):
    # every sample contains an outlier with probability (1 - w**s)**N = 1 - p
    return math.ceil(math.log(1 - p) / math.log(1 - w**s))


def line_through(a, b):
    return np.cross([*a, 1], [*b, 1])


def consensus(l, x, threshold):
    return np.abs(x @ l[:2] + l[2]) / np.hypot(l[0], l[1]) <= threshold


def sampson(F, x1, x2):
    y1, y2 = np.append(x1, 1), np.append(x2, 1)
    gradient = np.concatenate([(F @ y1)[:2], (F.T @ y2)[:2]])
    return abs(y2 @ F @ y1) / np.linalg.norm(gradient)


check("10.1", samples)
check("10.2", line_through)
check("10.3", consensus)
check("10.4", sampson)
