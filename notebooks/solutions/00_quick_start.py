"""Solutions of notebook 00."""

import numpy as np

from sfmkit.teaching import check

# Half of the field of view is atan(800 / f).
check("00.1", np.degrees(2 * np.arctan(800 / 1472)))

# One unit of the cloud is one baseline.
check("00.2", 8 * 1.36)

# No stage increases the count: keypoints, matches, inliers, points.
check("00.3", "points")
