"""A robust estimator."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from sfmkit.estimation import RobustModel


def estimate(
    x1: Tensor,
    x2: Tensor,
    K1: Tensor,
    K2: Tensor,
    *,
    threshold_px: float,
    confidence: float,
    seed: int,
    least: int = 6,
) -> RobustModel:
    """The essential matrix by least median of squares."""
    if len(x1) < least:
        return RobustModel.failed(len(x1))
    cv2.setRNGSeed(seed)
    normalised = [
        ((x - K[:2, 2]) / torch.stack([K[0, 0], K[1, 1]])).numpy() for x, K in ((x1, K1), (x2, K2))
    ]
    E, mask = cv2.findEssentialMat(*normalised, np.eye(3), cv2.LMEDS, confidence, 1e-3)
    if E is None or E.shape != (3, 3):
        return RobustModel.failed(len(x1))
    inliers = torch.tensor(mask.ravel() > 0)
    return RobustModel(torch.tensor(E), inliers, float(inliers.sum()), 0)
