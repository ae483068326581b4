"""What every robust estimator returns, whichever back end did the work."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class RobustModel:
    """A model and the matches that agree with it.

    Attributes:
        model: (3, 3) float64 E (normalised coordinates), F or H (pixels); None when no model was found.
        inliers: (N,) bool, Sampson distance below the threshold: one test for every back end, so that counts compare.
        score: the marginal score (:func:`sfmkit.geometry.losses.marginal_score`) of all matches, between 0 and N.
        iterations: minimal samples tried; 0 where the back end does not say.
        history: one entry for each improvement on the way, oldest first; empty where the back end does not say.
    """

    model: Tensor | None
    inliers: Tensor
    score: float
    iterations: int
    history: tuple[Improvement, ...] = ()

    @classmethod
    def failed(cls, n: int, iterations: int = 0, device: torch.device | str = "cpu") -> RobustModel:
        """No model for n matches."""
        return cls(None, torch.zeros(n, dtype=torch.bool, device=device), 0.0, iterations)


@dataclass(frozen=True, eq=False)
class Improvement:
    """A model that was the best so far.

    Attributes:
        iteration: minimal samples tried by then.
        model: (3, 3).
        inliers: how many of the matches it was scored on agree with it.
        score: its mean score per match it was scored on, in [0, 1].
        stage: ``sample``, ``local optimisation`` or ``refinement``.
    """

    iteration: int
    model: Tensor
    inliers: int
    score: float
    stage: str
