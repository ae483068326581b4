"""Features and kornia's local affine frames."""

from __future__ import annotations

import kornia.feature as KF
import numpy as np
import pytest
import torch

from sfmkit.errors import InputError
from sfmkit.features import keypoints_from_lafs, lafs_from_features
from sfmkit.types import Features


def some_features(n: int = 20) -> Features:
    g = np.random.default_rng(0)
    return Features(
        keypoints=g.uniform(0, 100, (n, 2)).astype(np.float32),
        scales=g.uniform(2, 30, n).astype(np.float32),
        angles=g.uniform(-3.1, 3.1, n).astype(np.float32),
        scores=g.uniform(0, 1, n).astype(np.float32),
        descriptors=g.uniform(0, 1, (n, 8)).astype(np.float32),
        norm="l2",
        operator="sift",
        size_wh=(100, 100),
    )


def test_lafs_convert_back_to_features():
    f = some_features()
    keypoints, scales, angles = keypoints_from_lafs(lafs_from_features(f))
    np.testing.assert_allclose(keypoints, f.keypoints, rtol=1e-6)
    np.testing.assert_allclose(scales, f.scales, rtol=1e-5)
    np.testing.assert_allclose(angles, f.angles, atol=1e-5)


def test_the_boundary_of_a_laf_is_the_described_circle_and_starts_at_the_angle():
    f = some_features()
    points = KF.laf_to_boundary_points(lafs_from_features(f), 40)[0].numpy()
    away = points - f.keypoints[:, None]
    radii = np.linalg.norm(away[:, 1:], axis=-1)  # the first point is the centre
    np.testing.assert_allclose(
        radii, np.broadcast_to(f.scales[:, None] / 2, radii.shape), rtol=1e-4
    )
    first_axis = lafs_from_features(f)[0, :, :, 0].numpy()
    expected = np.stack([np.cos(f.angles), np.sin(f.angles)], 1) * f.scales[:, None] / 2
    np.testing.assert_allclose(first_axis, expected, atol=1e-4)


def test_no_features_give_no_lafs():
    assert lafs_from_features(some_features(0)).shape == (1, 0, 2, 3)


@pytest.mark.parametrize(
    "lafs", [torch.zeros(2, 5, 2, 3), torch.zeros(5, 2, 3), torch.full((1, 5, 2, 3), torch.nan)]
)
def test_wrong_lafs_are_rejected(lafs):
    with pytest.raises(InputError, match="lafs"):
        keypoints_from_lafs(lafs)
