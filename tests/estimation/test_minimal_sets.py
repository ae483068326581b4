"""A homography from exactly four matches, a fundamental matrix from exactly seven."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from sfmkit.estimation import robust

X = torch.rand(8, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 500
Y = torch.rand(8, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 500


def test_four_matches_give_their_homography():
    H = robust.estimate(X[:4], X[:4] * 1.2 + 3, model="homography").model
    truth = [[1.2, 0, 3], [0, 1.2, 3], [0, 0, 1]]
    np.testing.assert_allclose(H / H[2, 2], truth, atol=1e-9)


def test_seven_matches_give_one_of_opencvs_fundamental_matrices():
    F = robust.estimate(X[:7], Y[:7], model="fundamental").model.numpy()
    theirs, _ = cv2.findFundamentalMat(X[:7].numpy(), Y[:7].numpy(), cv2.FM_7POINT)
    apart = [np.abs(F / F[2, 2] - T / T[2, 2]).max() for T in theirs.reshape(-1, 3, 3)]
    assert min(apart) < 1e-6
