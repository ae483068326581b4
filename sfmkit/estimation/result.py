"""What every robust estimator returns, whichever back end did the work."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..errors import InputError
from ..geometry.checks import check_intrinsics, check_points
from ..types import Improvement


@dataclass(frozen=True, eq=False)
class RobustModel:
    """A model and the matches that agree with it.

    Attributes:
        model: (3, 3) float64 E (normalised coordinates), F or H (pixels); None when no model was
            found.
        inliers: (N,) bool, Sampson distance below the threshold: one test for every back end, so
            that counts compare.
        score: the marginal score (:func:`sfmkit.geometry.losses.marginal_score`) of all matches,
            between 0 and N.
        iterations: minimal samples tried; 0 where the back end does not say.
        history: one entry for each improvement on the way, oldest first; empty where the back end
            does not say.
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

    def to(self, device: torch.device | str) -> RobustModel:
        """The same result with its tensors on another device."""
        return replace(
            self,
            model=None if self.model is None else self.model.to(device),
            inliers=self.inliers.to(device),
            history=tuple(replace(i, model=i.model.to(device)) for i in self.history),
        )


KINDS = ("essential", "fundamental", "homography")


def check_model(model: str, x1: Tensor, x2: Tensor, K1: Tensor | None, K2: Tensor | None) -> None:
    """Check what every built-in estimator gets.

    Args:
        model: one of KINDS.
        x1, x2: (N, 2) pixels.
        K1, K2: (3, 3), needed for the essential matrix.

    Raises:
        InputError: unknown model, no intrinsics for E, wrong shapes or dtypes, NaN.
    """
    if model not in KINDS:
        raise InputError(f"there is no model {model!r}; there are {', '.join(KINDS)}")
    check_points(0, None, x1=x1, x2=x2)
    if x1.ndim != 2:
        raise InputError(
            f"robust estimation takes one set of matches (N, 2), not {tuple(x1.shape)}"
        )
    if model == "essential":
        if K1 is None or K2 is None:
            raise InputError("the essential matrix needs the intrinsics K1 and K2")
        check_intrinsics(x1, K1=K1, K2=K2)


def supported(
    found: RobustModel, x1: Tensor, x2: Tensor, least: int, threshold_px: float
) -> RobustModel:
    """What was found, or no model where its inliers determine none.

    Any number of copies of a few matches, or of points on one line of an image, agree with a whole
    family of models: they would all be inliers of an arbitrary one.

    Args:
        x1, x2: (N, 2) pixels.
        least: distinct matches that it takes.
        threshold_px: inliers that lie nearer than this to one line, in the root mean square, cannot
            be told from a line.
    """
    if found.model is None:
        return found
    y1, y2 = x1.detach()[found.inliers].double(), x2.detach()[found.inliers].double()
    rows = torch.cat((y1, y2), 1)
    # Mostly the first few tell: sorting all of them costs milliseconds.
    if len(torch.unique(rows[:256], dim=0)) < least and len(torch.unique(rows, dim=0)) < least:
        return RobustModel.failed(len(x1), found.iterations, x1.device)
    for y in (y1, y2):
        off_line = torch.linalg.eigvalsh(torch.cov(y.T, correction=0))[0]
        if float(off_line) < threshold_px**2:
            return RobustModel.failed(len(x1), found.iterations, x1.device)
    return found
