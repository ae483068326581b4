"""The exercises of the notebooks by number; :mod:`sfmkit.teaching.checking` grades them."""

from __future__ import annotations

from ..exercise import Exercise
from . import (
    ablation,
    differentiable_geometry,
    epipolar_geometry,
    features,
    homography,
    learned_features,
    matching,
    motion,
    own_photographs,
    quick_start,
    robust_estimation,
    triangulation,
)

__all__ = ["EXERCISES"]

# in the order of the notebooks
_NOTEBOOKS = (
    quick_start,
    features,
    matching,
    homography,
    epipolar_geometry,
    motion,
    triangulation,
    differentiable_geometry,
    ablation,
    own_photographs,
    robust_estimation,
    learned_features,
)

EXERCISES: dict[str, Exercise] = {
    number: task for notebook in _NOTEBOOKS for number, task in notebook.EXERCISES.items()
}
