"""The exercises of the notebooks, by notebook and number: see :mod:`sfmkit.teaching.checking`."""

from __future__ import annotations

from ..exercise import Exercise
from . import (
    ablation,
    differentiable_geometry,
    epipolar_geometry,
    features,
    homography,
    matching,
    motion,
    own_photographs,
    quick_start,
    triangulation,
)

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
)

EXERCISES: dict[str, Exercise] = {
    number: task for notebook in _NOTEBOOKS for number, task in notebook.EXERCISES.items()
}
