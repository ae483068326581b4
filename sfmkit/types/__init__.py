"""Types of the data flow: ``image -> Features -> Correspondences -> TwoView -> PointCloud``.

Every type is frozen and checks its fields when it is constructed, so later stages and notebook
cells can rely on them. Error messages name the field, the expected shape and the value received.
All types can be pickled and copied.

The arrays of :class:`Features` and :class:`Matches` are NumPy arrays, as in OpenCV. From
:class:`Correspondences` on, they are float64 torch tensors, on the CPU unless stated otherwise.
"""

from .camera import Camera, IntrinsicsSigma, LensModel
from .correspondences import MAX_OPERATORS, Correspondences, OperatorCounts
from .features import Features, Matches, Norm
from .frozen_mapping import FrozenMapping
from .point_cloud import PointCloud
from .two_view import Improvement, TwoView, Verdict

__all__ = [
    "MAX_OPERATORS",
    "Camera",
    "Correspondences",
    "Features",
    "FrozenMapping",
    "Improvement",
    "IntrinsicsSigma",
    "LensModel",
    "Matches",
    "Norm",
    "OperatorCounts",
    "PointCloud",
    "TwoView",
    "Verdict",
]
