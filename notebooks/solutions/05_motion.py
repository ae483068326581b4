"""Solutions of notebook 05."""

import numpy as np

from sfmkit.teaching import check


def centre(R, t):
    return -R.T @ t


def essential(R, t):
    x, y, z = t
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R


def in_front(X, R, t):
    return (X[:, 2] > 0) & ((X @ R.T + t)[:, 2] > 0)


def shifted(R, t, s):
    return t + R @ s


check("05.1", centre)
check("05.2", essential)
check("05.3", in_front)
check("05.4", "length of t")
check("05.5", shifted)
