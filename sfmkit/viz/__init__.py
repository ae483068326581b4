"""Matplotlib figures, and the colours of operators."""

from .colours import operator_colour, operator_rgb
from .figures import (
    cloud_figure,
    cloud_picture,
    epipolar_figure,
    feature_figure,
    match_figure,
    match_picture,
    photographs,
    save,
)

__all__ = [
    "cloud_figure",
    "cloud_picture",
    "epipolar_figure",
    "feature_figure",
    "match_figure",
    "match_picture",
    "operator_colour",
    "operator_rgb",
    "photographs",
    "save",
]
