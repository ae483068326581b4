"""Solutions of notebook 04."""

import numpy as np

from sfmkit.teaching import check


def line(F, x1):
    return F @ np.append(x1, 1)


def distance(l, x):
    return abs(l @ np.append(x, 1)) / np.hypot(l[0], l[1])


def essential(F, K1, K2):
    # x2^T F x1 = (K2 xn2)^T F (K1 xn1) = xn2^T (K2^T F K1) xn1
    return K2.T @ F @ K1


check("04.1", line)
check("04.2", distance)
check("04.3", essential)
check("04.4", 7)  # nine entries, minus the scale, minus det F = 0
