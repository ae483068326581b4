"""Solutions of notebook 02."""

import numpy as np

from sfmkit.teaching import check


def hamming(a, b):
    return int(np.unpackbits(a ^ b).sum())


def mutual_pairs(D):
    nearest = D.argmin(axis=1)
    back = D.argmin(axis=0)
    return np.array([(i, j) for i, j in enumerate(nearest) if back[j] == i])


def ratio(d):
    nearest, second = np.sort(d)[:2]
    return nearest / second


check("02.1", hamming)
check("02.2", mutual_pairs)
check("02.3", ratio)
