"""Solutions of notebook 03."""

import numpy as np

from sfmkit.teaching import check


def transfer_by_hand(H, x1):
    x2 = H @ np.append(x1, 1)
    return x2[:2] / x2[2]


def between(H12, H13):
    # from image 2 to image 1, then from image 1 to image 3
    return H13 @ np.linalg.inv(H12)


def turning(K, R):
    # pixel -> ray in camera 1 -> the same ray in camera 2 -> pixel
    return K @ R @ np.linalg.inv(K)


check("03.1", transfer_by_hand)
check("03.2", between)
check("03.3", turning)
check("03.4", 4)  # eight degrees of freedom, two equations per match
